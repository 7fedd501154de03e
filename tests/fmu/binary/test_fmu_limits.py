"""Limits that an FMU keeps: the stop time of the experiment, the bounds of its inputs."""

import math
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import fmi2LastSuccessfulTime, fmi2Terminated

from dropstitch.__main__ import main
from firmware_py.core.errors import InputError
from firmware_py.core.signals import PERIOD_S
from hil.emulator.physics import FmuPhysics


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
    told = len(instance.messages)
    with pytest.raises(FMICallException, match="status 3"):
        instance.step(PERIOD_S)
    assert "stop time" in instance.messages[told]
    assert instance.get(["time", "steps"]).tolist() == pytest.approx([start_s + 0.034, 2.0])
    instance.step(0.016)  # the instance is unchanged: a step within the experiment is taken
    with pytest.raises(FMICallException):
        instance.step(1e-4)


@pytest.mark.parametrize(("step_s", "stop_s"), [(0.1, 0.3), (0.017, 850.0), (0.017 + 4e-6, 1e4)])
def test_a_host_that_adds_its_steps_up_may_overshoot_by_rounding(instance, step_s, stop_s):
    """Sums of steps, and a last step within the 1e-9 to which FMPy compares times."""
    _start(instance, 0.0 if stop_s < 1e4 else stop_s - 0.017, stop_s)
    for _ in range(round((stop_s - instance.time_s) / step_s)):
        instance.step(step_s)
    assert instance.time_s > stop_s


def test_without_a_stop_time_there_is_no_limit(instance):
    instance.initialize()
    for _ in range(5):
        instance.step(100.0)
    assert instance.time_s == pytest.approx(500.0)


@pytest.mark.parametrize("stop_s", [-1.0, math.nan])
def test_a_stop_time_before_the_start_is_refused(instance, stop_s):
    with pytest.raises(FMICallException):
        _start(instance, 0.0, stop_s)
    assert "stop time" in instance.messages[-1]
    instance.initialize()


def test_a_reset_forgets_the_stop_time(instance):
    _start(instance, 0.0, 0.05)
    instance.fmu.reset()
    instance.initialize()
    instance.step(1.0)
    assert instance.time_s == pytest.approx(1.0)


def test_fmpys_own_simulation_reaches_the_stop_time_that_it_sets(toy_fmu):
    result = fmpy.simulate_fmu(
        str(toy_fmu), stop_time=8.704, output_interval=PERIOD_S, set_stop_time=True
    )
    assert result["time"][-1] == pytest.approx(8.704)


def _bounded_inputs(archive):
    """Inputs whose bounds the model description publishes."""
    inputs = [v for v in archive.description.modelVariables if v.causality == "input"]
    return [(v.name, float(v.min), float(v.max)) for v in inputs if v.min is not None]


def test_inputs_are_held_to_the_bounds_that_the_description_publishes(archive, instance):
    bounds = _bounded_inputs(archive)
    assert [name for name, _, _ in bounds] == ["torque_nm", "payload_kg"]
    for started in (False, True):
        if started:
            instance.initialize()
        for name, low, high in bounds:
            for value in (low, high):
                instance.set({name: value})
            for value in (np.nextafter(low, -np.inf), high + 0.1):
                told = len(instance.messages)
                with pytest.raises(FMICallException, match="status 3"):
                    instance.set({name: value})
                assert f"{name} = " in instance.messages[told]
                assert "outside" in instance.messages[told]
    assert instance.get([name for name, _, _ in bounds]).tolist() == [b[2] for b in bounds]
    instance.step(PERIOD_S)


def test_of_several_inputs_none_is_taken_where_one_is_out_of_bounds(instance):
    instance.initialize({"torque_nm": 1.0})
    with pytest.raises(FMICallException):
        instance.set({"torque_nm": 2.0, "payload_kg": -0.3})
    assert instance.get(["torque_nm", "payload_kg"]).tolist() == [1.0, 0.25]


def test_the_commands_refuse_a_payload_out_of_bounds_in_one_sentence(bundle_1dof, tmp_path, capsys):
    twin, out = str(tmp_path / "twin.fmu"), str(tmp_path / "run")
    assert main(["fmu", "build", str(bundle_1dof), "--out", twin, "--quiet"]) == 0
    for payload in ("-0.3", "3.5"):
        assert main(["fmu", "simulate", twin, "--out", out, "--payload-kg", payload]) == 2
        error = capsys.readouterr().err
        assert f"payload_kg = {payload} lies outside 0 to 3" in error
        assert error.count("\n") == 1
    with pytest.raises(InputError, match=r"payload_kg = 3\.5 lies outside 0 to 3"):
        FmuPhysics(Path(twin), dof=1, payload_kg=3.5)


def test_a_step_that_is_not_finite_is_discarded_and_a_smaller_one_is_taken(instance):
    """Damping over inertia is 2000/s: the toy is unstable at 2 ms, not at 0.1 ms."""
    instance.set({"parameters.length_m": 0.1, "parameters.damping_nms_rad": 10.0})
    instance.initialize({"torque_nm": 5.0, "payload_kg": 0.0})
    told, before = len(instance.messages), instance.get(["time", "tip_x_m", "steps"])
    with pytest.raises(FMICallException, match="status 2"):
        instance.step(2.0)
    assert "smaller step" in instance.messages[told]
    if instance.fmi == 2:  # what a host asks after a discarded step
        assert not instance.fmu.getBooleanStatus(fmi2Terminated)
        assert instance.fmu.getRealStatus(fmi2LastSuccessfulTime) == 0.0
    assert instance.get(["time", "tip_x_m", "steps"]).tolist() == before.tolist()
    for _ in range(20):
        instance.step(1e-4)
    assert instance.get(["time", "steps"]).tolist() == pytest.approx([2e-3, 20.0])
