"""The bus on real servos: what tests/firmware_py/bus/test_dynamixel.py asserts in memory."""

import msgspec
import numpy as np
import pytest

from firmware_py.bus.registers import POSITION_MODE, Register
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.bus.servo_models import model_named
from firmware_py.errors import InputError

pytestmark = pytest.mark.hitl

SILENCE_NS = 500_000_000
TRIPPED = -1
STILL_RAD = 0.01
"""More than the quantisation and the trembling of a servo that stands."""


def test_the_servos_are_what_the_configuration_says_and_stand_within_reach(rig):
    with rig.bus() as bus:
        bus.connect()
        low, high = rig.config.limits.angle_rad
        assert np.all((low <= bus.angle_rad) & (bus.angle_rad <= high)), "bring it to its zero"
        assert len(bus.firmware_versions) == rig.config.dof
    number = model_named(rig.config.servos[0].model).number
    assert rig.witness.registers(Register.MODEL_NUMBER) == [number] * rig.config.dof
    assert rig.witness.registers(Register.OPERATING_MODE) == [POSITION_MODE] * rig.config.dof


def test_what_the_bus_measures_is_what_the_sdk_reads(rig):
    with rig.bus() as bus:
        bus.connect()
        assert rig.read(bus) is BusStatus.OK
        measured_rad = bus.angle_rad.copy()
    model = model_named(rig.config.servos[0].model)
    pulses = np.array(rig.witness.registers(Register.PRESENT_POSITION))
    assert measured_rad == pytest.approx(
        (pulses - model.zero_pulse) * model.rad_per_pulse, abs=STILL_RAD
    )


def test_a_thousand_exchanges_pass_without_an_error(rig):
    with rig.bus() as bus:
        bus.connect()
        rows = []
        for _ in range(1000):
            rig.read(bus)
            rows.append([*bus.angle_rad, *bus.current_a])
    assert np.ptp(np.array(rows)[:, : rig.config.dof], axis=0).max() < STILL_RAD
    assert np.isfinite(rows).all()


def test_torque_goes_on_where_the_arm_stands_and_off_again(rig):
    with rig.bus() as bus:
        bus.connect()
        before_rad = bus.angle_rad.copy()
        bus.write(before_rad, rig.clock.now_ns() + round(rig.config.period_s * 1e9))
        assert bus.torque(True) is BusStatus.OK
        for _ in range(50):
            assert rig.read(bus) is BusStatus.OK
        assert np.abs(bus.angle_rad - before_rad).max() < STILL_RAD, "it does not jump"
        assert bus.torque(False) is BusStatus.OK


def test_a_servo_that_hears_nothing_stops_listening_to_goals(rig):
    model = model_named(rig.config.servos[0].model)
    if Register.BUS_WATCHDOG not in model.table:
        pytest.skip(f"{model.name} has no bus watchdog")
    with rig.bus() as bus:
        bus.connect()
        bus.write(bus.angle_rad, rig.clock.now_ns() + round(rig.config.period_s * 1e9))
        assert bus.torque(True) is BusStatus.OK
        rig.clock.sleep_until(rig.clock.now_ns() + SILENCE_NS)
        assert rig.witness.registers(Register.BUS_WATCHDOG) == [TRIPPED] * rig.config.dof
        assert bus.torque(False) is BusStatus.OK
    assert rig.witness.registers(Register.BUS_WATCHDOG) == [0] * rig.config.dof


def test_a_servo_that_is_not_there_is_named(rig):
    ids = {servo.id for servo in rig.config.servos}
    stranger = msgspec.structs.replace(rig.config.servos[0], id=max(ids) + 100)
    rig.config = msgspec.structs.replace(rig.config, servos=(stranger,))
    try:
        with rig.bus() as bus, pytest.raises(InputError, match=f"servo {stranger.id} "):
            bus.connect()
    finally:
        rig.config = rig.witness.config
