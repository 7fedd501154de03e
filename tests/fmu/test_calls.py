"""Calls of a compiled FMU through FMPy: values, bounds, states, refusals, stop time."""

import contextlib
import ctypes
import math
import platform
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import fmi2LastSuccessfulTime, fmi2Terminated
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_py.core.errors import FmuRefusal, InputError
from firmware_py.core.signals import PERIOD_S
from firmware_py.inference.fmu_instance import FmuInstance
from fmu.fmu_checker import exported_functions, varying_steps_s
from models.plant.step_model import names
from tests.fmu.toy import moving_inputs


def _refuses(instance, call, *words):
    """The call is an error with one message, and that message has these words."""
    logged = len(instance.messages)
    with pytest.raises(FMICallException, match="status 3"):
        call()
    assert len(instance.messages) == logged + 1
    for word in words:
        assert word in instance.messages[-1]


def test_every_function_of_the_headers_is_exported_and_nothing_else_of_ours(archive):
    library = ctypes.CDLL(str(archive.binary()))
    wanted = exported_functions(archive.fmi)
    assert {2: 44, 3: 75}[archive.fmi] == len(wanted)  # FMI 2.0.1 and 3.0: 44 and 75 functions
    assert [name for name in wanted if not hasattr(library, name)] == []
    for hidden in ("fmu_step", "model_flow", "VARIABLES"):
        assert not hasattr(library, hidden)


def test_a_machine_without_a_library_gets_one_sentence(archive, monkeypatch):
    monkeypatch.setattr(platform, "system", lambda: "Darwin")
    monkeypatch.setattr(platform, "machine", lambda: "arm64")
    with pytest.raises(InputError, match=r"no library for aarch64-darwin; build it with --platfo"):
        archive.instance()


# ---- Values -------------------------------------------------------------------------------------


def test_varying_steps_and_parameters_equal_the_interpreted_model(instance, toy):
    """Also a parameter that is tuned between two steps."""
    changes = {"length_m": 1.1, "damping_nms_rad": 0.05, "rest_rad": -0.4}
    u, steps_s = moving_inputs(200), varying_steps_s(200)
    instance.set({f"parameters.{name}": value for name, value in changes.items()})
    instance.initialize(dict(zip(names(toy.inputs), u[0], strict=True)))
    p = toy.parameter_values(changes)
    x = np.asarray(toy.initial(u[0], p)).ravel()
    for k, step_s in enumerate(steps_s):
        if k == 100:
            p = toy.parameter_values(changes | {"damping_nms_rad": 2.0})
            instance.set({"parameters.damping_nms_rad": 2.0})
        instance.set(dict(zip(names(toy.inputs), u[k], strict=True)))
        instance.step(float(step_s))
        x = toy.advance(x, u[k], p, step_s)
        expected = np.asarray(toy.output(x, u[k], p)).ravel()
        np.testing.assert_allclose(instance.get(names(toy.outputs)), expected, atol=1e-9, rtol=0)


def test_instances_in_threads_run_as_they_do_alone(archive):
    """A call of the library leaves Python's lock to the other threads.

    FMPy changes the working directory while it loads a library, so that happens in one thread.
    """

    def tip_m(instance, torque_nm):
        instance.initialize({"torque_nm": torque_nm})
        for _ in range(50):
            instance.step(PERIOD_S)
        return float(instance.get(["tip_x_m"])[0])

    torques_nm = [3.0, -3.0, 2.0, 1.0] * 4
    with contextlib.ExitStack() as stack, ThreadPoolExecutor(4) as pool:
        instances = [stack.enter_context(archive.instance()) for _ in torques_nm]
        together = list(pool.map(tip_m, instances, torques_nm))
    for torque_nm, tip in zip(torques_nm, together, strict=True):
        with archive.instance() as instance:
            assert tip_m(instance, torque_nm) == tip
    assert together[0] - together[1] > 0.1


def test_a_tick_of_the_robot_equals_set_step_and_get(toy_fmu_3, toy):
    """Without a step it evaluates only, before the start from the start's inputs."""
    inputs, outputs = names(toy.inputs), names(toy.outputs)
    with FmuInstance(toy_fmu_3) as ticking, FmuInstance(toy_fmu_3) as stepping:
        tick = ticking.tick_channel(inputs, outputs)
        for u, step_s in zip(
            moving_inputs(20), [0.0, 0.0, PERIOD_S, 0.0, *[0.01] * 16], strict=True
        ):
            tick.inputs[:] = u
            tick.run(step_s)
            stepping.set(inputs, u)
            if step_s:
                stepping.step(step_s)
            np.testing.assert_array_equal(tick.outputs, stepping.get(outputs))
        assert ticking.time_s == stepping.time_s
        before = tick.outputs.copy()
        tick.inputs[:] = math.nan
        with pytest.raises(FmuRefusal, match="torque_nm"):
            tick.run(PERIOD_S)
        np.testing.assert_array_equal(tick.outputs, before)
        state = max(ticking.variables.values(), key=lambda variable: variable.reference)
        with pytest.raises(FmuRefusal, match=f"{state.reference} is no output"):
            ticking.tick_channel(inputs, [state.name]).run(0.0)


def test_a_reset_instance_runs_as_a_new_one(instance):
    def run():
        instance.initialize()
        for _ in range(10):
            instance.step(PERIOD_S)
        return instance.get(["tip_x_m", "steps", "parameters.length_m"])

    first = run()
    instance.set({"parameters.length_m": 1.7, "torque_nm": 4.0})
    instance.step(PERIOD_S)
    instance.fmu.reset()
    np.testing.assert_array_equal(run(), first)


# ---- Refused values -----------------------------------------------------------------------------


def test_inputs_and_parameters_have_the_bounds_that_the_description_publishes(archive, instance):
    bounded = {
        v.name: (float(v.min), float(v.max))
        for v in archive.description.modelVariables
        if v.causality in ("input", "parameter") and v.min is not None
    }
    assert {"torque_nm", "payload_kg", "parameters.length_m"} < set(bounded)
    for started in (False, True):
        if started:
            instance.initialize()
        for name, (low, high) in bounded.items():
            for value in (low, high):
                instance.set({name: value})
            for value in (np.nextafter(low, -np.inf), high + 0.1):
                _refuses(instance, lambda: instance.set({name: value}), f"{name} = ", "outside")  # noqa: B023
    assert instance.get(list(bounded)).tolist() == [high for _, high in bounded.values()]


@pytest.mark.parametrize(
    "wrong",
    [{"torque_nm": math.nan}, {"torque_nm": -math.inf}, {"torque_nm": 2.0, "payload_kg": -0.3}],
    ids=["no number", "infinite", "out of bounds"],
)
def test_a_refused_input_leaves_every_input_as_it_was(instance, wrong):
    instance.initialize({"torque_nm": 1.0})
    _refuses(instance, lambda: instance.set({"payload_kg": 2.0} | wrong), list(wrong)[-1])
    assert instance.get(["torque_nm", "payload_kg"]).tolist() == [1.0, 0.25]


def test_outputs_unknown_references_and_wrong_types_are_refused(instance):
    instance.initialize()
    fetch = instance.fmu.getReal if instance.fmi == 2 else instance.fmu.getFloat64
    truth = instance.variables["in_range"].valueReference
    for name in ("tip_x_m", "time"):
        _refuses(instance, lambda name=name: instance.set({name: 0.0}), name, "calculated")
    _refuses(instance, lambda: fetch([10_000]), "10000")
    _refuses(instance, lambda: fetch([truth]), "in_range", "type")
    _refuses(instance, lambda: instance.fmu.getBoolean([0]), "time", "type")


def test_calls_that_are_not_offered_are_refused(instance):
    instance.initialize()
    if instance.fmi == 2:
        _refuses(instance, lambda: instance.fmu.getRealOutputDerivatives([1], [1]), "not offered")
        _refuses(instance, lambda: instance.fmu.getInteger([1]), "not offered")
        assert list(instance.fmu.getInteger([])) == []
    else:
        _refuses(instance, instance.fmu.enterStepMode, "not offered")
        _refuses(instance, lambda: instance.fmu.getInt32([1]), "not offered")
        assert list(instance.fmu.getInt32([])) == []
    instance.fmu.setDebugLogging(True, ["logStatusError"])
    _refuses(instance, lambda: instance.fmu.setDebugLogging(True, ["logAll"]), "logStatusError")


def test_the_token_of_another_fmu_is_refused(archive):
    archive.description.guid, token = "{0}", archive.description.guid
    try:
        with pytest.raises(Exception, match=r"[Ii]nstantiate"):
            archive.instance()
    finally:
        archive.description.guid = token


# ---- Steps --------------------------------------------------------------------------------------


def test_a_step_of_no_length_or_from_another_time_is_refused(instance):
    instance.initialize()
    for step_s in (0.0, -0.01, math.nan, 1e9):
        _refuses(instance, lambda step_s=step_s: instance.fmu.doStep(0.0, step_s), "step")
    instance.step(PERIOD_S)
    _refuses(instance, lambda: instance.fmu.doStep(0.5, PERIOD_S), "stands at")


def test_a_step_that_is_not_finite_is_discarded_and_a_smaller_one_is_taken(instance):
    """Damping over inertia is 2000/s: the toy is unstable at 2 ms, not at 0.1 ms."""
    instance.set({"parameters.length_m": 0.1, "parameters.damping_nms_rad": 10.0})
    instance.initialize({"torque_nm": 5.0, "payload_kg": 0.0})
    logged, before = len(instance.messages), instance.get(["time", "tip_x_m", "steps"])
    with pytest.raises(FMICallException, match="status 2"):
        instance.step(2.0)
    assert "smaller step" in instance.messages[logged]
    if instance.fmi == 2:  # what a host asks after a discarded step
        assert not instance.fmu.getBooleanStatus(fmi2Terminated)
        assert instance.fmu.getRealStatus(fmi2LastSuccessfulTime) == 0.0
    assert instance.get(["time", "tip_x_m", "steps"]).tolist() == before.tolist()
    for _ in range(20):
        instance.step(1e-4)
    assert instance.get(["time", "steps"]).tolist() == pytest.approx([2e-3, 20.0])


def _start(instance, start_s, stop_s):
    """Initialization with a stop time, as each version of the standard passes it."""
    if instance.fmi == 2:
        instance.fmu.setupExperiment(startTime=start_s, stopTime=stop_s)
        instance.fmu.enterInitializationMode()
    else:
        instance.fmu.enterInitializationMode(startTime=start_s, stopTime=stop_s)
    instance.fmu.exitInitializationMode()
    instance.time_s = start_s


@pytest.mark.parametrize("start_s", [0.0, 1e4])
def test_no_step_leads_beyond_the_stop_time(instance, start_s):
    """FMI 2.0 and 3.0: computing past a stop time that is defined is an error."""
    _start(instance, start_s, start_s + 0.05)
    instance.step(PERIOD_S)
    instance.step(PERIOD_S)
    _refuses(instance, lambda: instance.step(PERIOD_S), "stop time")
    assert instance.get(["time", "steps"]).tolist() == pytest.approx([start_s + 0.034, 2.0])
    instance.step(0.016)  # the instance is unchanged: a step within the experiment is taken
    _refuses(instance, lambda: instance.step(1e-4))
    instance.fmu.reset()  # forgets the stop time
    instance.initialize()
    for _ in range(5):
        instance.step(100.0)
    assert instance.time_s == pytest.approx(500.0)


@pytest.mark.parametrize(("step_s", "stop_s"), [(0.1, 0.3), (0.017, 850.0), (0.017 + 4e-6, 1e4)])
def test_a_host_that_adds_its_steps_up_may_overshoot_by_rounding(instance, step_s, stop_s):
    """Sums of steps, and a last step within the 1e-9 to which FMPy compares times."""
    _start(instance, 0.0 if stop_s < 1e4 else stop_s - 0.017, stop_s)
    for _ in range(round((stop_s - instance.time_s) / step_s)):
        instance.step(step_s)
    assert instance.time_s > stop_s


@pytest.mark.parametrize("stop_s", [-1.0, math.nan])
def test_a_stop_time_before_the_start_is_refused(instance, stop_s):
    _refuses(instance, lambda: _start(instance, 0.0, stop_s), "stop time")
    instance.initialize()


# ---- State machine ------------------------------------------------------------------------------

# The standards' state machines for Co-Simulation without event mode: call -> {state: next state}.
LEGAL = {
    "enter": {"instantiated": "initializing"},
    "exit": {"initializing": "stepping"},
    "step": {"stepping": "stepping"},
    "terminate": {"stepping": "terminated"},
    "set": {s: s for s in ("instantiated", "initializing", "stepping")},
    "get": {s: s for s in ("initializing", "stepping", "terminated")},
    "reset": {
        s: "instantiated" for s in ("instantiated", "initializing", "stepping", "terminated")
    },
}
CALLS = st.lists(st.sampled_from([*LEGAL, "save", "restore"]), min_size=1, max_size=25)


@settings(max_examples=40)
@given(calls=CALLS, torques_nm=st.lists(st.floats(-5, 5), min_size=25, max_size=25))
def test_calls_are_taken_where_they_are_legal_and_only_there(archive, calls, torques_nm):
    with archive.instance() as instance:
        fmu, state, saved = instance.fmu, "instantiated", None
        legal = {call: dict(table) for call, table in LEGAL.items()}
        if archive.fmi == 3:
            legal["get"]["instantiated"] = "instantiated"  # FMI 3.0 shows start values there
        do = {
            "enter": fmu.enterInitializationMode,
            "exit": fmu.exitInitializationMode,
            "step": lambda: instance.step(0.017),
            "terminate": fmu.terminate,
            "get": lambda: instance.get(["tip_x_m", "in_range"]),
            "reset": fmu.reset,
        }
        for call, torque_nm in zip(calls, torques_nm, strict=False):
            if call == "save":
                values = instance.get(["steps", "torque_nm"]) if state == "stepping" else None
                saved = (fmu.getFMUState(), state, instance.time_s, values)
                continue
            if call == "restore":
                if saved:
                    fmu.setFMUState(saved[0])
                    state, instance.time_s = saved[1], saved[2]
                    if saved[3] is not None:
                        np.testing.assert_array_equal(
                            instance.get(["steps", "torque_nm"]), saved[3]
                        )
                continue
            logged = len(instance.messages)
            try:
                do.get(call, lambda t=torque_nm: instance.set({"torque_nm": t}))()
                assert state in legal[call]
                state = legal[call][state]
                if call in ("enter", "reset"):
                    instance.time_s = 0.0
            except FMICallException:
                assert state not in legal[call]
                assert len(instance.messages) == logged + 1
