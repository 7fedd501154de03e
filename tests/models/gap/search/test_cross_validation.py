"""Cross-validation of an effect: which gains on the trials left out speak for it."""

from types import SimpleNamespace

import numpy as np
import pytest

from models.gap.diagnosis import diagnose
from models.gap.estimation.gauss_newton import FitPoint
from models.gap.residuals.fit_parameters import candidate_effects
from models.gap.search import cross_validation


@pytest.mark.parametrize(
    ("gains", "helps"),
    [
        ([251.3, -6.1, -46.7], True),  # softening, which the heaviest of three payloads shows
        ([40.0, 45.0, 50.0], True),
        ([1000.0], True),
        ([0.0, 0.0, 300.0], True),
        ([200.0, -150.0], False),  # fits one payload at the cost of the other
        ([30.0, -20.0, 25.0, -30.0], False),
        ([-1.0], False),
        ([0.0, 0.0], False),
    ],
)
def test_an_effect_must_gain_more_than_it_loses(monkeypatch, gains, helps):
    monkeypatch.setattr(cross_validation, "held_out_gains", lambda *fits: np.array(gains))
    monkeypatch.setattr(cross_validation, "nuisance_prior_fall", lambda *fits: 0.0)
    gain, least = cross_validation.held_out_gain(None, None, None)
    assert gain == pytest.approx(sum(gains))
    assert (gain > least) == helps


@pytest.mark.parametrize(("turn_sd", "helps"), [(0.5, False), (14.0, True)])
def test_a_nuisance_far_beyond_its_prior_speaks_for_the_effect_that_brings_it_back(
    monkeypatch, turn_sd, helps
):
    """It predicts what is left out as well as the effect does."""
    gains = np.array([-1.1, 0.2, 0.9])
    monkeypatch.setattr(cross_validation, "held_out_gains", lambda *fits: gains)
    parameters = [SimpleNamespace(trial=trial) for trial in (None, None, 0)]
    estimator = SimpleNamespace(
        residuals=SimpleNamespace(fit_parameters=parameters), prior=np.diag([1.0, 0.0, 1.0])
    )
    without, with_ = (
        (FitPoint(np.array(values), 0.0, []), np.ones(3, dtype=bool))
        for values in ([turn_sd, 0.0, 3.0], [0.0, turn_sd, 0.0])
    )
    gain, least = cross_validation.held_out_gain(estimator, without, with_)
    assert gain == pytest.approx(0.5 * turn_sd**2)
    assert (gain > least) == helps


@pytest.mark.parametrize(
    ("tilt_rad", "softer_nm_rad", "named"),
    [
        (0.001, 0.0, ()),  # a turn that a session may have
        (0.004, 0.0, ("marker_frame_tilt",)),
        (0.007, -30.0, ("marker_frame_tilt",)),
    ],
)
def test_a_tilted_frame_is_no_turn_of_many_standard_deviations(
    plant, hidden, tilt_rad, softer_nm_rad, named
):
    considered = ("marker_frame_tilt", "dead_time", "creep")
    others = [e for e in candidate_effects(plant) if e not in considered]
    trials = hidden(marker_frame_tilt_rad=tilt_rad, root_stiffness_1_nm_rad=softer_nm_rad)
    assert diagnose(plant, trials, leave_out=others).named == named
