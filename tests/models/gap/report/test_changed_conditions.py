"""Conditions of a diagnosis that no trial of the plant has."""

import numpy as np
import pytest

from models.gap.estimation.noise_floor import NoiseFloor
from models.gap.report.changed_conditions import changed_conditions
from models.plant.document import FittedTrial, Provenance

SPECTRUM = np.ones(3)
KEY = "1dof sinusoid 0.5236rad 4.352s 0rad 572x0.017s"


@pytest.fixture
def floor():
    curves = {KEY: {payload_kg: {"di": SPECTRUM} for payload_kg in (0.0, 2.0)}}
    return NoiseFloor(np.arange(3.0), {"di": SPECTRUM}, {"di": SPECTRUM}, curves)


def provenance(pressure_pa=41300.0):
    return Provenance(fitted_trials=(FittedTrial("a", "12", "measured", "", pressure_pa),))


@pytest.fixture
def trial(make_trial):
    def make(step_s=0.017, **changes):
        found = make_trial(np.zeros(50), **changes)
        found.columns["time_s"] = step_s * np.arange(50)
        return found

    return make


def test_nothing_is_told_where_nothing_changed(floor, trial):
    same = [trial(payload_kg=2.0, pressure_pa=41500.0), trial(payload_kg=0.01)]
    assert changed_conditions(provenance(), floor, same) == ()


def test_what_changed_is_told_beside_what_is_known(floor, trial):
    trials = [trial(0.02, payload_kg=1.0, pressure_pa=35e3), trial(payload_kg=2.0)]
    rows = {row.condition: row for row in changed_conditions(provenance(), floor, trials)}
    assert rows["step_s"].trials == pytest.approx((0.02,))
    assert rows["step_s"].plant == (0.017,)
    assert (rows["payload_kg"].plant, rows["payload_kg"].trials) == ((0.0, 2.0), (1.0,))
    assert 35e3 in rows["pressure_pa"].trials


def test_what_nobody_knows_has_not_changed(trial):
    unknown = NoiseFloor(np.arange(3.0), {}, {}, learned=False)
    trials = [trial(0.02, payload_kg=1.0, pressure_pa=35e3)]
    assert changed_conditions(provenance(0.0), unknown, trials) == ()
