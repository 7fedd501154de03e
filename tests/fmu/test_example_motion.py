"""Example motion: the FMU moves by itself until its host sets an input that moves."""

import fmpy
import numpy as np
import pytest

from firmware_py.core.motion import STUDY_PERIOD_S
from firmware_py.core.signals import PERIOD_S
from tests.fmu.conftest import TORQUE_NM

STEPS = 40
OUTPUTS = ("tip_x_m", "tip_z_m", "torque_filtered_nm", "mass_kg")


def _example_nm(steps):
    return TORQUE_NM * np.sin(2 * np.pi * PERIOD_S * np.arange(steps) / STUDY_PERIOD_S)


def _run(archive, torque_nm=None, **start):
    """Outputs of a run; the host sets the torque before each step, or leaves it."""
    rows = []
    with archive.instance() as instance:
        instance.initialize({name.replace("__", "."): value for name, value in start.items()})
        for k in range(STEPS):
            if torque_nm is not None:
                instance.set({"torque_nm": torque_nm[k]})
            instance.step(PERIOD_S)
            rows.append(instance.get(OUTPUTS))
    return np.array(rows)


def test_without_inputs_the_fmu_moves_as_if_a_host_led_it(archive):
    alone, led = _run(archive), _run(archive, _example_nm(STEPS))
    np.testing.assert_allclose(alone, led, rtol=0, atol=1e-12)
    assert np.ptp(alone[:, 0]) > 0.05
    heavy = _run(archive, payload_kg=2.0)  # an input that does not move may be set
    np.testing.assert_allclose(
        heavy, _run(archive, _example_nm(STEPS), payload_kg=2.0), rtol=0, atol=1e-12
    )


def test_a_host_that_sets_its_inputs_gets_nothing_of_it(archive):
    torque_nm = np.where(np.arange(STEPS) < 10, 0.0, 1.5)
    led = _run(archive, torque_nm)
    np.testing.assert_array_equal(led, _run(archive, torque_nm, example__scale=0.0))
    np.testing.assert_array_equal(led[:10], _run(archive, example__scale=0.0)[:10])
    with archive.instance() as instance:
        instance.initialize({"torque_nm": 0.0})
        instance.step(10 * PERIOD_S)
        assert instance.get(["torque_nm", "torque_filtered_nm"]).tolist() == [0.0, 0.0]


def test_the_first_input_that_a_host_sets_ends_it_for_good(archive):
    with archive.instance() as instance:
        instance.initialize()
        for _ in range(5):
            instance.step(PERIOD_S)
        followed = instance.get(["torque_nm"])[0]
        assert followed == pytest.approx(_example_nm(5)[-1], abs=1e-12)
        instance.set({"payload_kg": 1.0})
        instance.step(PERIOD_S)
        assert instance.get(["torque_nm"])[0] > followed
        state = instance.fmu.getFMUState()
        instance.set({"torque_nm": 0.3})
        instance.step(PERIOD_S)
        assert instance.get(["torque_nm"])[0] == 0.3
        instance.fmu.setFMUState(state)  # nobody had set it then
        instance.time_s -= PERIOD_S
        instance.step(PERIOD_S)
        assert instance.get(["torque_nm"])[0] == pytest.approx(_example_nm(7)[-1], abs=1e-12)
        instance.fmu.freeFMUState(state)
        instance.fmu.reset()
        instance.initialize()
        instance.step(PERIOD_S)
        instance.step(PERIOD_S)
        assert instance.get(["torque_nm"])[0] == pytest.approx(_example_nm(2)[-1], abs=1e-12)


def test_model_exchange_moves_too(archive):
    led = _run(archive, _example_nm(STEPS))
    found = fmpy.simulate_fmu(
        str(archive.path), fmi_type="ModelExchange", stop_time=STEPS * PERIOD_S,
        output_interval=PERIOD_S, output=["tip_x_m"], relative_tolerance=1e-8,
    )  # fmt: skip
    end_m = float(found["tip_x_m"][-1])
    assert end_m == pytest.approx(led[-1, 0], abs=2e-4)  # the toy's integrator is of order 2
