"""The gap located: nothing in noise, the right cell in a residual that has one."""

import numpy as np
import pytest

from models.gap.residuals.localisation import GapRegion, locate_gap, location_sentence
from models.plant.identification.noise_floor import (
    TrialGroup,
    coefficient_count,
    cosine_transform,
    trial_group_key,
)

COUNT, STEP_S = 512, 0.017


@pytest.fixture
def trials(make_trial):
    angle = 0.5 * np.sin(2 * np.pi * STEP_S * np.arange(COUNT) / 4.352)
    return [
        make_trial(angle, payload_kg=payload, trial=n, name=f"{payload:g}_{n}")
        for payload in (0.0, 2.0)
        for n in (1, 2)
    ]


def group_of(trials):
    signals = ("angle_1_rad", "tip_x_m")
    return TrialGroup(
        trial_group_key(trials[0]),
        tuple(range(len(trials))),
        signals,
        coefficient_count(COUNT, STEP_S),
    )


def noise(rng, group):
    return rng.standard_normal((len(group.trials), len(group.signals), group.coefficients))


@pytest.mark.slow
def test_noise_alone_is_seldom_located(trials):
    group = group_of(trials)
    found = [
        any(
            c.significant
            for c in locate_gap([group], trials, [noise(np.random.default_rng(s), group)])
        )
        for s in range(20)
    ]
    assert sum(found) <= 4  # one in twenty is expected; five or more have a chance below 0.3 %


def test_a_lag_on_the_return_is_said_so(trials):
    group = group_of(trials)
    rng = np.random.default_rng(1)
    angle = trials[0].angle_rad[:, 0]
    back = (angle > 0.05) & (np.gradient(angle) < 0)
    rows = noise(rng, group)
    for a, trial in enumerate(trials):
        rows[a, 1] += cosine_transform(6.0 * trial.meta.payload_kg * back, group.coefficients)
    cells = locate_gap([group], trials, [rows])
    top = next(c for c in cells if c.factor == "stroke")
    assert top.significant
    assert (top.signal, top.level) == ("tip_x_m", "return from positive angles")
    text = location_sentence(cells)
    assert "return from positive angles" in text
    assert "growing with payload" in text


def test_nothing_located_is_no_agreement():
    """An effect may be spread so thinly that it stands out nowhere: nothing more is claimed."""
    said = location_sentence([])
    assert "stands out from the noise floor" in said
    assert "agree" not in said


def test_a_trend_with_payload_needs_two_payloads():
    """Each motion has a region of its own, all of them for one payload."""

    def said(*payloads):
        found = [
            GapRegion("tip_x_m", "payload", f"{p} kg", floors, 0.0, 0.001, significant=True)
            for p, floors in zip(payloads, (9.0, 3.0), strict=True)
        ]
        return location_sentence(found)

    assert "falling with payload" in said(0, 2)
    assert "with payload" not in said(0, 0)
