"""Feedback loops on the linearised twin: margins over the grid, judged by python-control itself."""

import control
import numpy as np
import pytest

from firmware_py.goals.tip_plan import wrong_in_feedback
from models.plan.feedback import (
    as_system,
    design_feedback,
    frequencies,
    highest_gain,
    keeps_margins,
)
from models.plant.linear_twin import LinearTwins, tip_part
from models.plant.plant import read_plant

PERIOD_S, PAYLOADS_KG = 0.017, (0.0, 2.0)
INTEGRAL = control.tf([PERIOD_S], [1.0, -1.0], PERIOD_S)


def assert_stable(closed, twin):
    """States of the twin that neither goals move nor the tip shows stay as they are."""
    poles, drifting = (np.abs(np.linalg.eigvals(m)) for m in (closed.A, twin.A))
    assert np.all(poles < 1.0 + 1e-6)
    assert np.sum(poles > 1.0 - 1e-9) <= np.sum(drifting > 1.0 - 1e-9)


def test_every_loop_is_stable_and_keeps_6_db_and_45_degrees():
    """Filter, integrator, one period of delay, twin."""
    twins = LinearTwins(read_plant().step_model(1), PERIOD_S)
    design = design_feedback(read_plant(), 1, PERIOD_S, PAYLOADS_KG)
    w = frequencies(PERIOD_S)
    for payload_kg, (filter_,) in zip(PAYLOADS_KG, design.filters, strict=True):
        for sliding, stiffness in ((True, 1.0), (False, 1.0), (True, 1.2)):
            twin = twins.at(payload_kg, sliding=sliding, stiffness=stiffness)
            loop = as_system(filter_, PERIOD_S) * INTEGRAL * tip_part(twin)
            assert_stable(control.feedback(loop, 1), twin)
            response = control.frd(loop(np.exp(1j * w * PERIOD_S)), w)
            gains, phases, *_ = control.stability_margins(response, returnall=True)
            assert min((g for g in gains if g > 1.0), default=np.inf) >= 10 ** (6.0 / 20.0)
            assert all(g > 1.0 or g < 1e-3 for g in gains), "no lower gain loses stability"
            assert np.min(np.abs(phases), initial=180.0) >= 45.0
    assert keeps_margins(design)
    assert wrong_in_feedback(design, (None, None), 1, 10) == ""
    light, heavy = design.margins[0]
    assert light.crossover_rad_s > heavy.crossover_rad_s > 1.0


def test_both_loops_of_two_joints_are_stable_together_and_keep_their_margins():
    """Closed loop of two filters and the coupled twin by its poles; each margin by the response."""
    design = design_feedback(read_plant(), 2, PERIOD_S, (1.0,))
    assert [len(margins) for margins in design.margins] == [1, 1] and keeps_margins(design)
    twin = LinearTwins(read_plant().step_model(2), PERIOD_S).at(1.0)
    filters = control.append(*(as_system(f, PERIOD_S) * INTEGRAL for f in design.filters[0]))
    unit = control.ss([], [], [], np.eye(2), True)
    assert_stable(control.feedback(tip_part(twin) * filters, unit), twin)


@pytest.mark.slow
def test_the_highest_gain_of_a_known_loop_keeps_both_margins():
    """k/(s (s + 1)²): −180° at 1 rad/s, where the gain is k/2; 45° and 6 dB, some to spare."""
    w = np.geomspace(0.01, 100.0, 20_000)
    loop = 1.0 / (1j * w * (1j * w + 1.0) ** 2)
    gain, phase, *_ = control.stability_margins(control.frd(highest_gain([loop]) * loop, w))
    assert 20.0 * np.log10(gain) > 6.5
    assert phase == pytest.approx(48.0, abs=0.1), "the phase decides"
    light = 100.0 / (1j * w * (100.0 - w**2 + 1j * w))  # a mode at 10 rad/s, damped by 0.05
    gain, phase, *_ = control.stability_margins(control.frd(highest_gain([light]) * light, w))
    assert 20.0 * np.log10(gain) == pytest.approx(6.5, abs=0.02), "the gain decides"
    assert phase > 48.0
    assert highest_gain([loop, 4.0 * loop]) == pytest.approx(highest_gain([loop]) / 4.0)
