"""Compiled toy FMU in FMPy: exports, values, states, refusals."""

import ctypes
import math
import platform

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException

from firmware_py.core.errors import InputError
from firmware_py.core.signals import PERIOD_S
from fmu.fmu_checker import exported_functions
from fmu.parity import varying_steps_s
from models.plant.step_model import names


def _inputs(count):
    time_s = PERIOD_S * np.arange(count)
    return np.column_stack([2.0 * np.sin(3.0 * time_s), 0.5 + 0.5 * np.cos(time_s)])


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


def test_fmpys_own_simulation_equals_the_interpreted_model(toy_fmu, toy):
    """Through FMPy's simulate_fmu, not our stepper, with its input interpolation and recorder."""
    count = 300
    u = _inputs(count)
    signals = np.zeros(count, dtype=[(n, "f8") for n in ("time", *names(toy.inputs))])
    signals["time"] = PERIOD_S * np.arange(count)
    for k, name in enumerate(names(toy.inputs)):
        signals[name] = u[:, k]
    result = fmpy.simulate_fmu(
        str(toy_fmu), stop_time=(count - 1) * PERIOD_S, step_size=PERIOD_S,
        output_interval=PERIOD_S, input=signals, output=names(toy.outputs),
    )  # fmt: skip
    expected = toy.simulate(u[:-1], PERIOD_S)
    for k, name in enumerate(names(toy.outputs)):
        np.testing.assert_allclose(result[name].astype(float), expected[:, k], atol=1e-9, rtol=0)


def test_varying_steps_and_parameters_equal_the_interpreted_model(instance, toy):
    changes = {"length_m": 1.1, "damping_nms_rad": 0.05, "rest_rad": -0.4}
    u, steps_s = _inputs(200), varying_steps_s(200)
    instance.set({f"parameters.{name}": value for name, value in changes.items()})
    y = instance.run(names(toy.inputs), u, steps_s, names(toy.outputs))
    p = toy.parameter_values(changes)
    x = np.asarray(toy.initial(u[0], p)).ravel()
    for k, step_s in enumerate(steps_s):
        x = toy.advance(x, u[k], p, step_s)
        expected = np.asarray(toy.output(x, u[k], p)).ravel()
        np.testing.assert_allclose(y[k + 1], expected, atol=1e-9, rtol=0)


def test_a_parameter_may_be_tuned_between_steps(instance, toy):
    u = np.tile([1.0, 0.5], (40, 1))
    p = toy.parameter_values()
    x = np.asarray(toy.initial(u[0], p)).ravel()
    instance.initialize(dict(zip(names(toy.inputs), u[0], strict=True)))
    for k in range(40):
        if k == 20:
            p = toy.parameter_values({"damping_nms_rad": 2.0})
            instance.set({"parameters.damping_nms_rad": 2.0})
        x = toy.advance(x, u[k], p, PERIOD_S)
        instance.step(PERIOD_S)
    expected = np.asarray(toy.output(x, u[0], p)).ravel()
    np.testing.assert_allclose(instance.get(names(toy.outputs)), expected, atol=1e-9, rtol=0)


def test_outputs_follow_inputs_between_steps_and_at_the_start(instance):
    instance.initialize()
    instance.set({"payload_kg": 1.5})
    assert instance.get(["mass_kg"]) == 1.5
    instance.fmu.reset()
    instance.set({"parameters.rest_rad": 0.9, "payload_kg": 0.0})
    instance.initialize()
    assert instance.get(["tip_x_m"])[0] == pytest.approx(0.8 * math.sin(0.9), abs=1e-12)


def test_a_restored_state_continues_bit_by_bit(instance, archive):
    u = _inputs(60)

    def go_on(one, rows):
        answers = []
        for torque_nm, payload_kg in rows:
            one.set({"torque_nm": torque_nm, "payload_kg": payload_kg})
            one.step(PERIOD_S)
            answers.append(one.get(["tip_x_m", "torque_filtered_nm", "steps", "time"]))
        return np.array(answers)

    instance.initialize()
    go_on(instance, u[:30])
    instance.set({"parameters.length_m": 0.7})  # a change that has not been stepped yet
    state, time_s = instance.fmu.getFMUState(), instance.time_s
    data = instance.fmu.serializeFMUState(state)
    straight = go_on(instance, u[30:])
    instance.fmu.setFMUState(state)
    instance.time_s = time_s
    np.testing.assert_array_equal(go_on(instance, u[30:]), straight)
    with archive.instance() as other:  # fresh, not even initialized
        other.fmu.setFMUState(other.fmu.deserializeFMUState(data))
        other.time_s = time_s
        np.testing.assert_array_equal(go_on(other, u[30:]), straight)
        assert other.fmu.serializeFMUState(other.fmu.getFMUState()) != data


@pytest.mark.parametrize("damage", ["short", "long", "other FMU", "empty"])
def test_bytes_that_are_not_a_state_of_this_fmu_are_refused(instance, damage):
    instance.initialize()
    data = instance.fmu.serializeFMUState(instance.fmu.getFMUState())
    wrong = {
        "short": data[:-8], "long": data + bytes(8), "empty": b"",
        "other FMU": b"{0000" + data[5:],
    }[damage]  # fmt: skip
    with pytest.raises(FMICallException):
        instance.fmu.deserializeFMUState(wrong)
    instance.step(PERIOD_S)


def test_two_instances_are_independent(archive):
    with archive.instance() as first, archive.instance() as second:
        first.initialize({"torque_nm": 3.0})
        second.initialize({"torque_nm": -3.0})
        for _ in range(20):
            first.step(PERIOD_S)
            second.step(PERIOD_S)
        apart = first.get(["tip_x_m"]) - second.get(["tip_x_m"])
        with archive.instance() as alone:
            alone.initialize({"torque_nm": 3.0})
            for _ in range(20):
                alone.step(PERIOD_S)
            assert alone.get(["tip_x_m"]) == first.get(["tip_x_m"])
    assert apart > 0.1


def test_reset_begins_anew(instance):
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


def _refuses(instance, call, *words):
    told = len(instance.messages)
    with pytest.raises(FMICallException):
        call()
    assert len(instance.messages) == told + 1
    for word in words:
        assert word in instance.messages[-1]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_is_refused_and_nothing_is_taken(instance, value):
    instance.initialize({"torque_nm": 1.0})
    _refuses(
        instance,
        lambda: instance.set({"payload_kg": 2.0, "torque_nm": value}),
        "torque_nm", "finite",
    )  # fmt: skip
    assert instance.get(["torque_nm", "payload_kg"]).tolist() == [1.0, 0.25]


@pytest.mark.parametrize(
    ("value", "taken"), [(0.1, True), (2.0, True), (0.0999, False), (2.1, False)]
)
def test_parameters_are_held_to_their_bounds(instance, value, taken):
    if taken:
        instance.set({"parameters.length_m": value})
    else:
        _refuses(
            instance, lambda: instance.set({"parameters.length_m": value}), "length_m", "outside"
        )


def test_calls_in_the_wrong_state_are_refused(instance):
    _refuses(instance, lambda: instance.step(PERIOD_S), "DoStep", "instantiated")
    _refuses(instance, instance.fmu.exitInitializationMode, "instantiated")
    _refuses(instance, instance.fmu.terminate, "instantiated")
    instance.initialize()
    _refuses(instance, instance.fmu.enterInitializationMode, "step mode")
    instance.step(PERIOD_S)
    instance.fmu.terminate()
    _refuses(instance, lambda: instance.step(PERIOD_S), "terminated")
    _refuses(instance, lambda: instance.set({"torque_nm": 1.0}), "terminated")
    assert np.isfinite(instance.get(["tip_x_m"]))


def test_outputs_and_time_cannot_be_set(instance):
    instance.initialize()
    for name in ("tip_x_m", "time"):
        _refuses(instance, lambda name=name: instance.set({name: 0.0}), name, "calculated")


@pytest.mark.parametrize("step_s", [0.0, -0.01, math.nan, math.inf, 1e9])
def test_steps_that_are_none_are_refused(instance, step_s):
    instance.initialize()
    _refuses(instance, lambda: instance.fmu.doStep(0.0, step_s), "step")
    instance.step(PERIOD_S)


def test_a_step_from_elsewhere_is_refused(instance):
    instance.initialize()
    instance.step(PERIOD_S)
    _refuses(instance, lambda: instance.fmu.doStep(0.5, PERIOD_S), "stands at")


def test_a_step_that_blows_up_leaves_the_fmu_unchanged(instance):
    """Damping over inertia is 2000/s: the integration of the toy is unstable at 2 ms."""
    instance.set({"parameters.length_m": 0.1, "parameters.damping_nms_rad": 10.0})
    instance.initialize({"torque_nm": 5.0, "payload_kg": 0.0})
    before = instance.get(["time", "steps"])
    _refuses(instance, lambda: instance.step(2.0), "not finite")
    np.testing.assert_array_equal(instance.get(["time", "steps"]), before)
    instance.set({"parameters.damping_nms_rad": 0.0})
    instance.step(PERIOD_S)


def test_unknown_references_and_wrong_types_are_refused(instance):
    instance.initialize()
    fetch = instance.fmu.getReal if instance.fmi == 2 else instance.fmu.getFloat64
    truth = instance.variables["in_range"].valueReference
    _refuses(instance, lambda: fetch([10_000]), "10000")
    _refuses(instance, lambda: fetch([truth]), "in_range", "type")
    _refuses(instance, lambda: instance.fmu.getBoolean([0]), "time", "type")


def test_what_is_not_offered_says_so(instance):
    instance.initialize()
    if instance.fmi == 2:
        _refuses(instance, lambda: instance.fmu.getRealOutputDerivatives([1], [1]), "not offered")
        _refuses(instance, lambda: instance.fmu.getInteger([1]), "not offered")
        assert list(instance.fmu.getInteger([])) == []
    else:
        _refuses(instance, instance.fmu.enterStepMode, "not offered")
        _refuses(instance, lambda: instance.fmu.getInt32([1]), "not offered")
        assert list(instance.fmu.getInt32([])) == []


def test_only_the_error_category_can_be_logged(instance):
    instance.fmu.setDebugLogging(True, ["logStatusError"])
    _refuses(instance, lambda: instance.fmu.setDebugLogging(True, ["logAll"]), "logStatusError")


def test_the_token_of_another_fmu_is_refused(archive):
    archive.description.guid, token = "{0}", archive.description.guid
    try:
        with pytest.raises(Exception, match=r"[Ii]nstantiate"):
            archive.instance()
    finally:
        archive.description.guid = token
