"""Samples of trials with occluded markers."""

from dataclasses import replace

import numpy as np

from models.predictor.validation import collect_samples
from models.trials.deformation import deformation_index


def test_rows_without_any_marker_are_left_out(toy_trials):
    trial = toy_trials(1)[0]
    hidden = np.r_[100:110]
    columns = {
        name: np.where(np.isin(np.arange(len(trial)), hidden), np.nan, column)
        if name.startswith("m") and name[1:3].isdigit()
        else column
        for name, column in trial.columns.items()
    }
    blind = replace(trial, columns=columns)
    samples = collect_samples((blind,), {"true": [deformation_index(blind)]})
    assert len(samples) == len(trial) - trial.meta.rest_samples - len(hidden)
    assert np.isfinite(samples.features("true")).all()
