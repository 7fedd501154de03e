"""The observer on runs of the plant: payload and index, whatever the step."""

from dataclasses import replace

import numpy as np
import pytest

from models.plant.plant import read_plant
from models.plant.simulation.runner import CompiledModel
from models.plant.step_model import names

STEP_S, PERIOD_S, REST = 0.017, 4.352, 40
HALF = REST + 128


@pytest.fixture(scope="module")
def units():
    plant = read_plant().with_values(
        {"root_limit_moment_nm": 55.0}  # it bounds creep and hysteresis too
        | {f"directional_stiffness_{j}": 0.15 for j in (1, 2)}
        | {f"hysteresis_share_{j}": 0.3 for j in (1, 2)}
    )
    return {
        (dof, unit): CompiledModel(plant.step_model(dof, unit))
        for dof in (1, 2)
        for unit in ("twin", "observer")
    }


def goal(count, amplitude_rad):
    moving_s = STEP_S * np.maximum(np.arange(count) - REST, 0)
    return -amplitude_rad * np.sin(2 * np.pi / PERIOD_S * moving_s)


def twin_run(units, dof, payload_kg, amplitude_rad=0.52, count=REST + 400, changes=()):
    compiled = units[dof, "twin"]
    columns = [goal(count, amplitude_rad)] * dof + [np.full(count, payload_kg)]
    p = compiled.model.parameter_values(dict(changes))
    y = compiled.simulate(np.column_stack(columns), STEP_S, p)
    return y[:, : 2 * dof], dict(zip(names(compiled.model.outputs), y.T, strict=True))


def observe(units, dof, measured, changes=()):
    compiled = units[dof, "observer"]
    p = compiled.model.parameter_values(dict(changes))
    y = compiled.simulate(measured[1:], STEP_S, p, compiled.start(measured[0], p))
    return dict(zip(names(compiled.model.outputs), y.T, strict=True))


@pytest.mark.parametrize(("dof", "payload_kg"), [(1, 0.0), (2, 0.7)])
def test_payload_index_and_tip_are_those_of_the_twin(units, dof, payload_kg):
    measured, true = twin_run(units, dof, payload_kg)
    observed = observe(units, dof, measured)
    assert np.abs(observed["payload_kg"][HALF:] - payload_kg).max() < 0.05
    error = (observed["di"] - true["di"])[HALF:]
    assert np.sqrt(np.mean(error**2)) < 0.1 * np.std(true["di"][HALF:])
    tip = sum((observed[f"tip_{a}_m"] - true[f"tip_{a}_m"])[HALF:] ** 2 for a in "xyz")
    assert np.sqrt(np.mean(tip)) < 0.004


@pytest.mark.parametrize(
    "changes",
    # A root hinge that is damped strongly has little mass above it in a short link.
    [{}, {"root_damping_1_nm_s_rad": 5.0, "span_position": 0.13}],
    ids=["nominal", "fast pole"],
)
def test_long_internal_steps_cost_no_accuracy(units, changes):
    measured, _ = twin_run(units, 1, 2.0, count=REST + 150)
    model = read_plant().with_values(changes).step_model(1, "observer")
    exact, observed = (
        observe({(1, "observer"): CompiledModel(replace(model, max_substep_s=step_s))}, 1, measured)
        for step_s in (2.5e-4, model.max_substep_s)
    )
    for axis in "xz":
        assert np.abs(observed[f"tip_{axis}_m"] - exact[f"tip_{axis}_m"]).max() < 5e-5
    assert np.abs(observed["di"] - exact["di"]).max() < 5e-6


def test_friction_that_differs_from_the_plants_is_not_taken_for_payload(units):
    more = {"coulomb_friction_1_nm": 1.2 * 4.5}
    measured, _ = twin_run(units, 1, 1.0, changes=more)
    assert observe(units, 1, measured)["payload_kg"][HALF:] == pytest.approx(1.0, abs=0.06)


def test_noise_and_quantisation_of_the_servo_do_not_matter(units):
    rng = np.random.default_rng(5)
    measured, true = twin_run(units, 1, 1.5)
    quantum = np.array([2 * np.pi / 501_923, 0.016113])
    noisy = np.round((measured + [0, 1] * rng.normal(0, 0.03, measured.shape)) / quantum) * quantum
    observed = observe(units, 1, noisy)
    assert np.abs(observed["payload_kg"][HALF:] - 1.5).max() < 0.06
    assert np.corrcoef(observed["di"][HALF:], true["di"][HALF:])[0, 1] > 0.995


def test_the_estimate_does_not_change_at_rest(units):
    """Dry friction carries the arm: the current shows nothing of the payload."""
    rng = np.random.default_rng(6)
    still = np.column_stack([np.full(600, 0.2), rng.normal(0.4, 0.05, 600)])
    payload_kg = observe(units, 1, still)["payload_kg"]
    assert np.abs(payload_kg - payload_kg[0]).max() < 0.02
    measured, _ = twin_run(units, 1, 2.0)
    rest = np.tile(np.add(measured[-1], [0.0, 0.3]), (300, 1))
    payload_kg = observe(units, 1, np.concatenate([measured, rest]))["payload_kg"]
    assert payload_kg[-1] == pytest.approx(2.0, abs=0.05)


def test_a_known_payload_is_used(units):
    measured, true = twin_run(units, 1, 2.0)
    observed = observe(units, 1, measured, {"payload_known_kg": 2.0})
    assert (observed["payload_kg"] == 2.0).all()
    assert np.abs(observed["di"] - true["di"]).max() < 2e-4


def test_a_wrong_plant_has_a_larger_innovation(units):
    measured, _ = twin_run(units, 1, 1.5)
    model = units[1, "observer"].model
    stiffness = {v.name: 0.8 * v.start for v in model.parameters if "_stiffness_" in v.name}
    right, wrong = observe(units, 1, measured), observe(units, 1, measured, stiffness)
    assert wrong["innovation_1_a"][HALF:].mean() > 3 * right["innovation_1_a"][HALF:].mean()
    assert right["tip_x_deviation_m"][:REST].max() < right["tip_x_deviation_m"].max()
    assert right["tip_x_deviation_m"][-HALF:].max() < 2e-3  # the payload is known by then
    known = observe(units, 1, measured, {"payload_known_kg": 1.5})
    assert (known["tip_x_deviation_m"] == 0.0).all()


def test_steps_may_be_missed(units):
    """Every fifth sample is lost: the step is then twice as long."""
    measured, true = twin_run(units, 1, 1.5)
    model = units[1, "observer"].model
    p = model.parameter_values()
    x, last = np.asarray(model.initial(measured[0], p)).ravel(), 0
    rows = []
    for k in range(1, len(measured)):
        if k % 5 == 0:
            continue
        x = model.advance(x, measured[k], p, (k - last) * STEP_S)
        last = k
        rows.append((k, *np.asarray(model.output(x, measured[k], p)).ravel()))
    rows = np.array([row for row in rows if row[0] >= HALF])
    expected = true["di"][rows[:, 0].astype(int)]
    payload = 1 + names(model.outputs).index("payload_kg")
    assert np.abs(rows[:, payload] - 1.5).max() < 0.15
    assert np.sqrt(np.mean((rows[:, 1] - expected) ** 2)) < 0.1 * np.std(expected)


def test_wild_currents_leave_the_payload_within_its_bounds(units):
    measured, _ = twin_run(units, 1, 1.0, count=REST + 200)
    measured[100:110, 1], measured[130:140, 1] = 1e6, -1e6
    payload_kg = observe(units, 1, measured)["payload_kg"]
    assert np.isfinite(payload_kg).all()
    assert (payload_kg >= 0).all() and (payload_kg <= 3).all()
