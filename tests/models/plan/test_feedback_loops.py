"""Feedback loops on the linearised twin: margins over the grid, judged by python-control itself."""

import control
import numpy as np
import pytest

from firmware_py.goals.feedback_design import wrong_in_feedback
from models.plan.feedback import (
    as_system,
    crossover_rad_s,
    design_feedback,
    frequencies,
    gain_margin,
    keeps_margins,
    phase_margin_rad,
)
from models.plant.linear_twin import LinearTwins, frequency_response, modes, tip_part
from models.plant.plant import read_plant

PERIOD_S, PAYLOADS_KG = 0.017, (0.0, 2.0)


@pytest.fixture(scope="module")
def twins():
    return LinearTwins(read_plant(), 1, PERIOD_S)


@pytest.fixture(scope="module")
def design():
    return design_feedback(read_plant(), 1, PERIOD_S, PAYLOADS_KG)


def loop_of(own, twin):
    """Filter, integrator, one period of delay, twin."""
    integral = control.tf([PERIOD_S], [1.0, -1.0], PERIOD_S)
    return as_system(own, PERIOD_S) * integral * tip_part(twin, 1)


@pytest.mark.parametrize("k", [0, 1])
@pytest.mark.parametrize(("sliding", "stiffness"), [(True, 1.0), (False, 1.0), (True, 1.2)])
def test_every_loop_is_stable_and_keeps_6_db_and_45_degrees(twins, design, k, sliding, stiffness):
    twin = twins.at(PAYLOADS_KG[k], sliding=sliding, stiffness=stiffness)
    loop = loop_of(design.filters[k][0], twin)
    poles = np.abs(np.linalg.eigvals(control.feedback(loop, 1).A))
    drifting = np.sum(poles > 1.0 - 1e-9)  # states that neither goals move nor the tip shows
    assert np.all(poles < 1.0 + 1e-6) and drifting <= np.sum(
        np.abs(np.linalg.eigvals(twin.A)) > 1 - 1e-9
    )
    w = frequencies(PERIOD_S)
    response = control.frd(frequency_response(loop, w)[:, 0, 0], w)
    gains, phases, *_ = control.stability_margins(response, returnall=True)
    assert min((g for g in gains if g > 1.0), default=np.inf) >= 10 ** (6.0 / 20.0)
    assert all(g > 1.0 or g < 1e-3 for g in gains), "no gain below this one loses stability"
    assert np.min(np.abs(phases), initial=180.0) >= 45.0


def test_the_design_states_its_margins(design):
    assert keeps_margins(design)
    assert wrong_in_feedback(design, (None, None), 1, 10) == ""
    light, heavy = design.margins[0]
    assert light.crossover_rad_s > heavy.crossover_rad_s > 1.0


def test_both_loops_of_two_joints_are_stable_together_and_keep_their_margins():
    """Closed loop of two filters and the coupled twin by its poles; each margin by the response."""
    design = design_feedback(read_plant(), 2, PERIOD_S, (1.0,))
    assert [len(own) for own in design.margins] == [1, 1] and keeps_margins(design)
    twin = LinearTwins(read_plant(), 2, PERIOD_S).at(1.0)
    integral = control.tf([PERIOD_S], [1.0, -1.0], PERIOD_S)
    filters = control.append(*(as_system(f, PERIOD_S) * integral for f in design.filters[0]))
    closed = control.feedback(tip_part(twin, 2) * filters, control.ss([], [], [], np.eye(2), True))
    poles, own = (np.abs(np.linalg.eigvals(m)) for m in (closed.A, twin.A))
    assert np.all(poles < 1.0 + 1e-6)
    assert np.sum(poles > 1.0 - 1e-9) <= np.sum(own > 1.0 - 1e-9), "the integrators are closed"


def test_margins_of_a_known_loop():
    """1/(s (s + 1)): crossover at 0.786 rad/s, phase margin 51.8°, no gain margin to lose."""
    w = np.geomspace(0.01, 100.0, 20_000)
    loop = 1.0 / (1j * w * (1j * w + 1.0))
    assert np.degrees(phase_margin_rad(loop)) == pytest.approx(51.8, abs=0.1)
    assert crossover_rad_s(loop, w) == pytest.approx(0.786, abs=1e-3)
    third = loop / (1j * w + 1.0)  # 1/(s (s + 1)²): −180° at 1 rad/s, where the gain is 1/2
    assert gain_margin(third) == pytest.approx(2.0, rel=1e-3)


def test_margins_lie_between_the_frequencies_of_a_coarse_grid():
    """1/(s (s + 1)²) with a tenth between frequencies: 1/2 at −180°, 0.682 rad/s, 21.4°."""
    w = np.geomspace(0.01, 100.0, 97)
    loop = 1.0 / (1j * w * (1j * w + 1.0) ** 2)
    assert gain_margin(loop) == pytest.approx(2.0, rel=0.01)
    assert np.degrees(phase_margin_rad(loop)) == pytest.approx(21.4, abs=0.2)
    assert crossover_rad_s(loop, w) == pytest.approx(0.682, rel=0.01)


def test_a_linear_twin_moves_like_the_twin(twins):
    """A small step of the goal: the same tip after half a second, at rest, to 1 %."""
    model = read_plant().step_model(1)
    twin = twins.at(1.0, sliding=False)
    at = twin.output_labels.index("tip_x_m")
    small, rows = 1e-5, 30
    x0 = np.asarray(model.initial(np.array([0.0, 1.0]), model.parameter_values())).ravel()
    quiet = model.simulate(np.tile([0.0, 1.0], (rows, 1)), PERIOD_S, x=x0)[:, at]
    moved = model.simulate(np.tile([small, 1.0], (rows, 1)), PERIOD_S, x=x0)[:, at]
    _, y = control.forced_response(
        twin, np.arange(rows + 1) * PERIOD_S, np.full((1, rows + 1), small)
    )  # fmt: skip
    assert y[at][-1] == pytest.approx((moved - quiet)[-1], rel=0.01)


def test_the_first_mode_of_the_link_falls_with_the_payload(twins):
    light, heavy = (next(m for m in modes(twins.at(kg)) if m.damping < 0.3) for kg in PAYLOADS_KG)
    assert light.frequency_rad_s > 1.5 * heavy.frequency_rad_s
