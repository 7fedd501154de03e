"""Nuisance of a plant of another load, on the trials of its identification and on others."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from models.gap.residuals.fit_parameters import (
    KNOWN_VALUE_FRACTION,
    is_known_elsewhere,
    nuisance_fit_parameters,
)
from models.plant.plant import NOMINAL, read_plant
from models.trials.trial import Trial, TrialMeta, TrialSet


def trial(mass_kg):
    meta = TrialMeta(
        dof=1, payload_kg=0.0, trial=1, motion="steps", source="measured", period_s=1.0,
        rest_samples=1, conditions={"mass_kg": mass_kg},
    )  # fmt: skip
    return Trial(f"{mass_kg}", meta, {"time_s": 0.01 * np.arange(100)})


def fitted_to(plant, trials):
    fitted = plant.provenance.fitted_with(trials)
    return msgspec.structs.replace(plant.provenance, fitted_trials=fitted)


@pytest.fixture
def pendulum():
    return read_plant(NOMINAL.parent / "examples" / "xl330_pendulum.toml")


def test_only_a_plant_of_other_trials_is_known(pendulum):
    one, other = trial(0.5), trial(0.6)
    assert not is_known_elsewhere(pendulum, TrialSet((one,)))
    identified = replace(pendulum, provenance=fitted_to(pendulum, [one]))
    assert is_known_elsewhere(identified, TrialSet((other,)))
    assert not is_known_elsewhere(identified, TrialSet((one,)))
    assert not is_known_elsewhere(identified, TrialSet((one, other)))


def test_the_link_has_priors_of_its_own_for_what_changes_from_day_to_day():
    link = read_plant()
    identified = replace(link, provenance=fitted_to(link, [trial(0.5)]))
    assert not is_known_elsewhere(identified, TrialSet((trial(0.6),)))


def test_values_of_a_known_plant_stay_within_some_per_cent(pendulum):
    free = {q.name: q for q in nuisance_fit_parameters(pendulum, 1)}
    known = {q.name: q for q in nuisance_fit_parameters(pendulum, 1, True)}
    assert free.keys() == known.keys() and len(known) > 3
    for name, q in known.items():
        value = abs(pendulum.parameters[name].value)
        assert q.standard_deviation == pytest.approx(KNOWN_VALUE_FRACTION * value)
        assert q.standard_deviation < free[name].standard_deviation
        assert (q.low, q.high) == (free[name].low, free[name].high)
