"""Limits that an FMU keeps: the stop time of the experiment."""

import math

import fmpy
import pytest
from fmpy.fmi1 import FMICallException

from firmware_py.signals import PERIOD_S
from fmu.fmpy_instance import FmuArchive


@pytest.fixture(scope="module")
def archive(toy_fmu):
    with FmuArchive(toy_fmu) as archive:
        yield archive


@pytest.fixture
def instance(archive):
    with archive.instance() as instance:
        yield instance


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


def test_fmpys_own_simulation_reaches_the_stop_time_that_it_sets(toy_fmu):
    result = fmpy.simulate_fmu(
        str(toy_fmu), stop_time=8.704, output_interval=PERIOD_S, set_stop_time=True
    )
    assert result["time"][-1] == pytest.approx(8.704)
