"""A step of the observer costs no more at rest, where decaying states pass subnormal numbers."""

import time

import numpy as np

from firmware_py.core.signals import PERIOD_S
from firmware_py.inference.fmu_instance import FmuInstance
from fmu.fmu_builder import build_fmu
from models.plant.plant import read_plant
from models.plant.step_model import names

MOVING, RESTING, TIMED = 300, 600, 400


def test_a_step_at_rest_takes_no_longer_than_one_in_motion(tmp_path):
    model = read_plant().step_model(1, "observer")
    path = build_fmu(model, tmp_path / "observer.fmu")
    moving, resting = FmuInstance(path), FmuInstance(path)

    def step_ns(instance, angle_rad):
        channel = instance.channel(names(model.inputs))
        channel.values[:] = angle_rad
        channel.send()
        start_ns = time.thread_time_ns()
        instance.step(PERIOD_S)
        return time.thread_time_ns() - start_ns

    for k in range(MOVING):
        step_ns(resting, 0.3 * np.sin(0.02 * k))
    for _ in range(RESTING):
        step_ns(resting, 0.0)
    rows = [(step_ns(moving, 0.3 * np.sin(0.02 * k)), step_ns(resting, 0.0)) for k in range(TIMED)]
    moving_ns, resting_ns = np.median(rows, axis=0)
    assert resting_ns < 1.5 * moving_ns
