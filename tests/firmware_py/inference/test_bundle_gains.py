"""Gains with which a plant was identified: from the log into the bundle, asked of the servos."""

import json
import shutil
from pathlib import Path

import msgspec
import numpy as np
import pytest

from firmware_py.bus.dynamixel import DynamixelBus
from firmware_py.bus.loopback import LoopbackTransport
from firmware_py.bus.registers import Register
from firmware_py.bus.servo_models import MODELS, ServoGains
from firmware_py.config import BusConfig, RobotConfig, ServoConfig
from firmware_py.core.errors import InputError
from firmware_py.core.signals import tick_dtype
from firmware_py.inference.bundle import ModelBundle, read_manifest
from firmware_py.inference.manifest import write_manifest
from firmware_py.log.recorder import recording
from firmware_py.robot import build_bus, with_bundle_gains
from firmware_py.system.clock import SimClock
from models.commands.identify import read_servo_gains

ROBOT = Path("robot.toml")
TEXT = 'bundle = "b"\n[bus]\nport = "p"\n[[servos]]\nid = 1\nmodel = "H54-200-S500-R"\n'


def robot_of(gains=None):
    servo = ServoConfig(id=1, model="H54-200-S500-R", gains=gains)
    return RobotConfig(bundle="b", bus=BusConfig(port="p"), servos=(servo,))


@pytest.fixture
def bundle(toy_bundle, tmp_path):
    def build(*gains):
        path = shutil.copytree(toy_bundle, tmp_path / "bundle")
        write_manifest(path, msgspec.structs.replace(read_manifest(path), servo_gains=gains))
        return ModelBundle.load(path)

    return build


def test_the_servo_must_have_the_gains_of_the_bundle(bundle):
    config = with_bundle_gains(robot_of(), bundle(ServoGains(position_p=32)), ROBOT)
    clock, model = SimClock(), MODELS[54024]
    for found, fits in ((32, True), (31, False)):
        transport = LoopbackTransport({1: model})
        transport.put(1, Register.POSITION_P_GAIN, found)
        bus: DynamixelBus = build_bus(config, transport, clock)
        if fits:
            bus.connect()
        else:
            with pytest.raises(InputError, match="identified with 32"):
                bus.connect()
        assert transport.get(1, Register.TORQUE_ENABLE) == 0


def test_a_gain_that_the_file_gives_otherwise_is_refused(bundle):
    loaded = bundle(ServoGains(position_p=32))
    with pytest.raises(InputError, match=r"position_p = 31, the bundle's .* with 32"):
        with_bundle_gains(robot_of(ServoGains(position_p=31)), loaded, ROBOT)
    both = with_bundle_gains(robot_of(ServoGains(velocity_i=14)), loaded, ROBOT).servos[0].gains
    assert (both.position_p, both.velocity_i) == (32, 14)


def test_a_bundle_that_does_not_say_changes_nothing(bundle):
    config = robot_of(ServoGains(velocity_i=14))
    assert with_bundle_gains(config, bundle(), ROBOT) == config


def test_a_gain_that_the_servo_has_not_is_refused(bundle):
    with pytest.raises(InputError, match="has no Position D Gain"):
        with_bundle_gains(robot_of(), bundle(ServoGains(position_d=1)), ROBOT)


@pytest.mark.parametrize("gains", [(ServoGains(),) * 3, (ServoGains(position_p=-1),)])
def test_gains_of_a_manifest_have_bounds(bundle, gains):
    with pytest.raises(InputError, match="servo_gains"):
        bundle(*gains)


def test_the_gains_of_a_log_are_those_found_in_the_servos(tmp_path):
    found = [{"Position P Gain": 640, "Velocity I Gain": 14, "Drive Mode": 0}]
    path = tmp_path / "run.mcap"
    with recording(path, 1, 0, {"servo_settings": json.dumps(found)}) as telemetry:
        telemetry.put(np.zeros(1, tick_dtype(1))[0])
    assert read_servo_gains(path) == (ServoGains(position_p=640, velocity_i=14),)


def test_damaged_settings_of_a_log_are_refused_in_one_sentence(tmp_path):
    path = tmp_path / "run.mcap"
    with recording(path, 1, 0, {"servo_settings": "[" * 100_000}) as telemetry:
        telemetry.put(np.zeros(1, tick_dtype(1))[0])
    with pytest.raises(InputError, match="holds damaged settings"):
        read_servo_gains(path)


def test_the_gains_of_a_robot_are_those_of_its_file(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(f"{TEXT}gains = {{ position_p = 32 }}\n", encoding="utf-8")
    assert read_servo_gains(path) == (ServoGains(position_p=32),)
    path.write_text(TEXT, encoding="utf-8")
    with pytest.raises(InputError, match="does not give the gains"):
        read_servo_gains(path)
