"""Prior: chance differs from trial to trial, a clock that is late in all of them is no chance."""

import numpy as np
import pytest

from models.gap.diagnosis import diagnose
from models.gap.residuals.fit_parameters import (
    FitParameter,
    candidate_effects,
    prior_matrix,
    prior_precision,
)

TRIALS = 6
PARAMETERS = [
    FitParameter(name, "trial", {}, {}, deviation, trial=t)
    for t in range(TRIALS)
    for name, deviation in (("friction", 0.05), ("sync_s", 0.002))
] + [FitParameter("creep_share_1", "effect")]
CLOCKS = np.array([q.name == "sync_s" for q in PARAMETERS])
ALTERNATING = np.resize([1.0, -1.0], TRIALS)


def cost(values):
    return float(values @ prior_matrix(PARAMETERS) @ values)


def test_each_costs_by_its_own_deviation_and_an_effect_costs_nothing():
    precision = prior_precision(PARAMETERS)
    assert precision[0] == pytest.approx(0.05**-2) and precision[-1] == 0.0
    friction = np.where(CLOCKS | (precision == 0), 0.0, 0.05)
    assert cost(friction) == pytest.approx(TRIALS), "friction may be higher in all trials"


def test_clocks_may_differ_but_not_be_late_together():
    values = np.zeros(len(PARAMETERS))
    values[CLOCKS] = 0.002 * ALTERNATING
    assert cost(values) == pytest.approx(TRIALS)
    values[CLOCKS] = 0.0001
    assert cost(values) > 100


@pytest.mark.slow
@pytest.mark.parametrize("hidden_s", [0.013, -0.013])
def test_an_offset_beyond_what_counts_as_synchronised_is_named(plant, hidden, hidden_s):
    """Clocks of single trials would take up what exceeds 10 ms."""
    considered = ("sync_offset", "dead_time", "creep", "marker_frame_tilt")
    others = [e for e in candidate_effects(plant) if e not in considered]
    found = diagnose(plant, hidden(sync_offset_s=hidden_s), leave_out=others)
    assert found.named == ("sync_offset",)
    known = found.improved.parameters["sync_offset_s"]
    assert known.value == pytest.approx(hidden_s, abs=3 * known.error)
