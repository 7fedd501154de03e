"""Robot from a configuration: payload of the observer, bus and loop."""

import contextlib

import numpy as np
import pytest

from firmware_py.bus.loopback import LoopbackTransport
from firmware_py.config import BusConfig, RobotConfig, ServoConfig, read_config
from firmware_py.core.errors import InputError
from firmware_py.core.signals import PERIOD_S
from firmware_py.inference.bundle import ModelBundle
from firmware_py.inference.fmu_instance import FmuInstance
from firmware_py.robot import NoModels, build_bus, build_loop, load_bundle
from firmware_py.safety.limits import Limits
from firmware_py.system.clock import SimClock
from tests.firmware_py.test_config import MINIMAL


@pytest.fixture
def load(observer_bundle, tmp_path):
    """Load the bundle by a configuration with or without a payload; return both."""

    def load(payload_kg=None):
        path = tmp_path / "robot.toml"
        payload = "" if payload_kg is None else f"payload_kg = {payload_kg}"
        text = MINIMAL.replace('"bundle"', f'"{observer_bundle}"')
        path.write_text(payload + text, encoding="utf-8")
        config = read_config(path)
        return config, load_bundle(config, path)

    return load


def motion(count=150):
    """Angles and currents of a link that is heavy at the tip, shape (n, 1) each."""
    angle_rad = 0.5 * np.sin(2 * np.pi * PERIOD_S / 4.352 * np.arange(count))[:, None]
    return angle_rad, 2.0 * np.sin(angle_rad)


def answers(estimator):
    estimator.reset()
    return np.array([estimator.update(q, i, PERIOD_S)[:2] for q, i in zip(*motion(), strict=True)])


def test_a_known_payload_is_the_observers(load, observer_bundle):
    _, bundle = load(2.0)
    answered = answers(bundle.estimator)
    assert (answered[:, 1] == 2.0).all()
    assert np.array_equal(answers(bundle.estimator), answered), "it outlasts a reset"
    with FmuInstance(observer_bundle / "observer.fmu") as observer:
        observer.set(["parameters.payload_known_kg"], [2.0])
        for (q, i), (di, _) in zip(zip(*motion(), strict=True), answered, strict=True):
            observer.set(["angle_1_rad", "current_1_a"], [q[0], i[0]])
            observer.step(PERIOD_S)
            assert observer.get(["di"])[0] == di
    bundle.assume_payload(0.0)
    light = answers(bundle.estimator)
    assert (light[:, 1] == 0.0).all()
    assert light[100:, 0].max() < answered[100:, 0].max(), "a lighter tip bends the link less"


def test_an_unknown_payload_is_estimated(load, toy_bundle):
    _, bundle = load()
    estimated = answers(bundle.estimator)
    assert len(np.unique(estimated[:, 1])) > 10
    bundle.assume_payload(2.0)
    bundle.assume_payload(None)
    assert np.array_equal(answers(bundle.estimator), estimated)
    lagged = ModelBundle.load(toy_bundle)  # it estimates no payload
    estimated = answers(lagged.estimator)
    lagged.assume_payload(1.0)
    assert np.array_equal(answers(lagged.estimator), estimated, equal_nan=True)


def test_more_than_the_observer_takes_is_refused(load):
    with pytest.raises(InputError, match=r"^payload_kg: is 50\.0.*leave it out"):
        load(50.0)


# --- bus and loop from the configuration ---------------------------------------------------------


def robot_config(**changes):
    servos = (ServoConfig(id=1, model="H54-200-S500-R"),)
    return RobotConfig(
        **{"bundle": "", "bus": BusConfig(port="memory"), "servos": servos} | changes
    )


def run_of(config):
    clock = SimClock()
    servos = {setup.id: setup.model for setup in config.setups()}
    transport = LoopbackTransport(servos)
    with contextlib.closing(build_bus(config, transport, clock)) as bus:
        return build_loop(config, NoModels(), bus, clock).run()


def test_the_loop_of_a_configuration_runs_its_motion_once_at_its_period():
    config = robot_config(period_s=0.02)
    summary = run_of(config)
    goals_rad = config.goals_rad()
    moving = summary.records[summary.records["tick"] >= 0]
    assert (np.diff(moving["deadline_ns"]) == 20_000_000).all()
    assert np.array_equal(moving["goal_1_rad"][: len(goals_rad)], goals_rad[:, 0])
    with pytest.raises(InputError, match=r"the limit is 0\.5 rad/s"):
        run_of(robot_config(limits=Limits(rate_rad_s=0.5)))
