"""Model Exchange: samples at time events, saturation as a state event, parity with steps."""

import ctypes
import itertools
import math
from dataclasses import replace

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import fmi2EventInfo
from scipy.integrate import solve_ivp

from firmware_py.core.signals import PERIOD_S
from fmu.fmpy_instance import FmuArchive
from fmu.fmu_builder import build_fmu
from models.plant.step_model import names
from tests.fmu.toy import LIMIT_NM

COUNT = 60
TIME_S = PERIOD_S * np.arange(COUNT + 1)
TORQUE_NM = 4.8 * np.sin(2 * np.pi * TIME_S / 0.7)


def inputs(toy, torque_nm):
    """Input table of FMPy: the torque is constant over a period, the payload throughout."""
    rows = [(TIME_S[0], torque_nm[0], 0.25)]
    for k in range(1, COUNT + 1):
        rows += [(TIME_S[k], torque_nm[k - 1], 0.25), (TIME_S[k], torque_nm[k], 0.25)]
    return np.array(rows, [(name, float) for name in ("time", *names(toy.inputs))])


def run(path, toy, interface_type, torque_nm=TORQUE_NM, **options):
    return fmpy.simulate_fmu(
        str(path), fmi_type=interface_type, input=inputs(toy, torque_nm), relative_tolerance=1e-9,
        stop_time=COUNT * PERIOD_S, output_interval=PERIOD_S, output=names(toy.outputs),
        record_events=False, **options,
    )  # fmt: skip


def exact_tip_x_m(toy):
    """Tip by an adaptive integration of the model's own rate."""
    p, x, rows = toy.parameter_values(), np.array([0.2025, 0.0]), []
    for torque_nm in TORQUE_NM:
        rows.append(0.8 * np.sin(x[0]))
        solution = solve_ivp(
            lambda _, x, u=torque_nm: np.asarray(toy.rate([*x, 0, 0], [u, 0.25], p)).ravel()[:2],
            (0, PERIOD_S), x, rtol=1e-11, atol=1e-12,
        )  # fmt: skip
        x = solution.y[:, -1]
    return np.array(rows)


def test_an_adaptive_solver_gets_the_exact_motion_and_the_samples_of_a_step(toy_fmu, toy):
    exchange = run(toy_fmu, toy, "ModelExchange", solver="CVode")
    steps = run(toy_fmu, toy, "CoSimulation")
    np.testing.assert_allclose(exchange["tip_x_m"], exact_tip_x_m(toy), rtol=0, atol=1e-7)
    # a midpoint step of 2 ms has an error of 1e-5
    np.testing.assert_allclose(exchange["tip_x_m"], steps["tip_x_m"], rtol=0, atol=2e-5)
    for sampled in ("steps", "torque_filtered_nm"):
        np.testing.assert_array_equal(exchange[sampled], steps[sampled])


@pytest.fixture
def exchange(archive):
    """An instance for Model Exchange at its first event."""
    with archive.instance("ModelExchange") as instance:
        instance.initialize()
        yield instance


def update(instance):
    """(again, terminate, nominals changed, states changed, next event defined, its time)."""
    fmu = instance.fmu
    return fmu.newDiscreteStates() if instance.fmi == 2 else fmu.updateDiscreteStates()


def go_to(instance, time_s):
    """Event mode at a later time."""
    instance.fmu.enterContinuousTimeMode()
    instance.fmu.setTime(time_s)
    instance.fmu.enterEventMode()


def vector(call, count=2):
    buffer = (ctypes.c_double * count)()
    call(buffer, count)
    return np.array(buffer)


def test_time_events_come_once_a_period(exchange):
    assert update(exchange)[4:] == (True, pytest.approx(PERIOD_S, abs=1e-15))
    for k in range(1, 4):
        go_to(exchange, k * PERIOD_S)
        assert exchange.get(["steps"]) == k - 1  # published at the event
        again, terminate, nominals, _, defined, next_s = update(exchange)
        assert (again, terminate, nominals, defined) == (False, False, False, True)
        assert next_s == pytest.approx((k + 1) * PERIOD_S, abs=1e-12)
        assert exchange.get(["steps"]) == k
    go_to(exchange, 3.5 * PERIOD_S)
    assert update(exchange)[5] == pytest.approx(4 * PERIOD_S)  # an event of the host: no sample
    assert exchange.get(["steps"]) == 3
    go_to(exchange, 8 * PERIOD_S)  # a host that passed over samples gets the next one in time
    assert update(exchange)[5] == pytest.approx(9 * PERIOD_S)
    assert exchange.get(["steps"]) == 4


def test_an_event_writes_every_value_that_it_returns(exchange):
    """A host need not clear them before the call."""
    fmu = exchange.fmu
    if exchange.fmi == 2:
        info = fmi2EventInfo(1, 1, 1, 1, 0, -1.0)
        fmu.fmi2NewDiscreteStates(fmu.component, ctypes.byref(info))
        found = [getattr(info, name) for name, _ in info._fields_]
    else:
        values = [*(ctypes.c_bool(True) for _ in range(4)), ctypes.c_bool(), ctypes.c_double(-1.0)]
        fmu.fmi3UpdateDiscreteStates(fmu.component, *map(ctypes.byref, values))
        found = [v.value for v in values]
    assert found == [0, 0, 0, 0, 1, pytest.approx(PERIOD_S)]


def test_an_indicator_changes_its_sign_at_the_saturation(exchange):
    signs = []
    for torque_nm in (-LIMIT_NM - 0.1, -LIMIT_NM + 0.1, LIMIT_NM - 0.1, LIMIT_NM + 0.1):
        exchange.set({"torque_nm": torque_nm})
        signs.append(np.sign(vector(exchange.fmu.getEventIndicators)))
    changes = [np.count_nonzero(a != b) for a, b in itertools.pairwise(signs)]
    assert changes == [1, 0, 1]


def test_states_have_nominals_and_rates(exchange, toy):
    np.testing.assert_array_equal(vector(exchange.fmu.getNominalsOfContinuousStates), [1.0, 1.0])
    exchange.fmu.enterContinuousTimeMode()
    exchange.fmu.setContinuousStates((ctypes.c_double * 2)(0.3, -0.7), 2)
    rates = np.asarray(toy.rate([0.3, -0.7, 0, 0], [0.0, 0.25], toy.parameter_values())).ravel()
    get = exchange.fmu.getDerivatives if exchange.fmi == 2 else (
        exchange.fmu.getContinuousStateDerivatives
    )  # fmt: skip
    np.testing.assert_array_equal(vector(get), rates[:2])
    with pytest.raises(FMICallException):
        exchange.fmu.setContinuousStates((ctypes.c_double * 2)(math.nan, 0.0), 2)
    with pytest.raises(FMICallException):
        exchange.fmu.setContinuousStates((ctypes.c_double * 3)(), 3)


def test_calls_of_the_other_interface_type_are_refused(exchange, archive):
    state = exchange.fmu.getFMUState()
    with archive.instance() as stepping:
        stepping.initialize()
        with pytest.raises(FMICallException):
            stepping.fmu.setFMUState(state)
        assert "other interface type" in stepping.messages[-1]
        stepping.step(PERIOD_S)
    exchange.fmu.freeFMUState(state)


def test_parameters_change_at_events_only(exchange):
    update(exchange)
    name = "parameters.damping_nms_rad"
    exchange.set({name: 0.5})
    exchange.fmu.enterContinuousTimeMode()
    with pytest.raises(FMICallException):
        exchange.set({name: 0.4})
    assert "enter the event mode" in exchange.messages[-1]
    exchange.set({"torque_nm": 1.0})
    assert exchange.get([name]) == 0.5


def test_the_stop_time_ends_model_exchange_too(archive):
    with archive.instance("ModelExchange") as instance:
        instance.initialize(stop_s=0.05)
        update(instance)
        instance.fmu.enterContinuousTimeMode()
        instance.fmu.setTime(0.06)  # an integrator may look beyond the stop time, but not go there
        with pytest.raises(FMICallException):
            instance.fmu.enterEventMode()
        assert "stop time" in instance.messages[-1]
        instance.fmu.setTime(0.05)
        instance.fmu.enterEventMode()


def test_a_saved_state_continues_within_a_period(exchange):
    update(exchange)
    exchange.fmu.enterContinuousTimeMode()
    exchange.fmu.setTime(0.01)
    before, state = vector(exchange.fmu.getContinuousStates), exchange.fmu.getFMUState()
    exchange.fmu.enterEventMode()
    exchange.set({"torque_nm": 3.0})
    exchange.fmu.setFMUState(state)
    exchange.fmu.freeFMUState(state)
    np.testing.assert_array_equal(vector(exchange.fmu.getContinuousStates), before)
    with pytest.raises(FMICallException):
        update(exchange)  # the mode is part of the state
    exchange.fmu.enterEventMode()
    assert update(exchange)[5] == pytest.approx(PERIOD_S)


@pytest.fixture(scope="module")
def sampled_fmu(toy, tmp_path_factory):
    path = tmp_path_factory.mktemp("sampled") / "sampled.fmu"
    return build_fmu(replace(toy, inputs_at_end=True), path, fmi=3)


def test_a_sampled_model_steps_at_its_events(sampled_fmu):
    """Without continuous states the outputs are those of Co-Simulation, bit by bit."""
    with (
        FmuArchive(sampled_fmu) as archive,
        archive.instance() as steps,
        archive.instance("ModelExchange") as events,
    ):
        events.initialize({"torque_nm": TORQUE_NM[0]})
        steps.initialize({"torque_nm": TORQUE_NM[0]})
        update(events)
        for k in range(1, 20):
            go_to(events, k * PERIOD_S)
            events.set({"torque_nm": TORQUE_NM[k]})
            update(events)
            steps.set({"torque_nm": TORQUE_NM[k]})
            steps.step(PERIOD_S)
            outputs = ["tip_x_m", "steps"]
            np.testing.assert_array_equal(events.get(outputs), steps.get(outputs))


def test_a_sample_of_a_whole_step_has_derivatives(sampled_fmu, toy):
    """Against central differences of the interpreted step, along a direction and adjoint."""
    u, p = np.array([1.0, 0.25]), toy.parameter_values()
    x, step = np.asarray(toy.initial(u, p)).ravel(), 1e-6
    direction = np.array([0.3, -1.0, 0.0, 0.7, 1.5, 0.4])  # of states, then inputs

    def after(size):
        z = np.array([*x, *u]) + size * direction
        return np.asarray(toy.advance(z[:4], z[4:], p, PERIOD_S)).ravel()

    expected = (after(step) - after(-step)) / (2 * step)
    with FmuArchive(sampled_fmu) as archive, archive.instance("ModelExchange") as events:
        events.initialize({"torque_nm": 1.0})
        table = {v.name: v.valueReference for v in archive.description.modelVariables}
        states = [table[f"states.{name}"] for name in names(toy.states)]
        knowns = [*states, *(table[name] for name in names(toy.inputs))]
        found = events.fmu.getDirectionalDerivative(states, knowns, list(direction))
        gradient = events.fmu.getAdjointDerivative(states, knowns, [1.0, 2.0, 3.0, 4.0], 6)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8)
    assert np.dot(gradient, direction) == pytest.approx(np.dot(found, [1, 2, 3, 4]), abs=1e-12)
