"""Trial of a run that was stopped while it still rested: a trial file that can be read again."""

from types import SimpleNamespace

import numpy as np
import pytest

from firmware_py.core.motion_config import MotionConfig
from firmware_py.link.link_description import STUDY_LINK
from hil.sil import sil_results
from models.trials.files import read_trial, write_trial


@pytest.mark.parametrize(("rows", "rest_rows"), [(40, 39), (59, 58), (200, 59)])
def test_a_run_stopped_at_rest_leaves_a_trial_that_can_be_read(
    monkeypatch, tmp_path, rows, rest_rows
):
    signals = ("goal_1_rad", "angle_1_rad", "current_1_a")
    records = np.zeros(rows, dtype=[("tick", int), *((s, float) for s in signals)])
    records["tick"] = np.arange(rows)
    monkeypatch.setattr(sil_results, "true_tip_m", lambda records, truth: np.zeros((rows, 3)))
    link = STUDY_LINK.conditions()
    result = SimpleNamespace(records=records, outcome=SimpleNamespace(truth=None), link=link)
    options = SimpleNamespace(
        dof=1,
        payload_kg=0.0,
        period_s=0.017,
        motion=MotionConfig(rest_s=1.0),
        plan=None,
        goals=None,
    )
    trial = sil_results.as_trial(result, options)
    assert read_trial(write_trial(trial, tmp_path)).meta.rest_samples == rest_rows
