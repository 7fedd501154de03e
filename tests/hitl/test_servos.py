"""Bus on real servos: the assertions of tests/firmware_py/bus/test_dynamixel.py on hardware."""

import msgspec
import numpy as np
import pytest

from firmware_py.bus.registers import POSITION_MODE, Register
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.bus.servo_models import model_named
from firmware_py.core.errors import InputError

pytestmark = pytest.mark.hitl

SILENCE_NS = 500_000_000
TRIPPED = -1
STILL_RAD = 0.01
"""More than the quantisation and the trembling of a servo that stands."""


def test_the_servos_are_what_the_configuration_says_and_stand_within_reach(hardware):
    with hardware.bus() as bus:
        bus.connect()
        low, high = hardware.config.limits.angle_rad
        assert np.all((low <= bus.angle_rad) & (bus.angle_rad <= high)), "bring it to its zero"
        assert len(bus.firmware_versions) == hardware.config.dof
    number = model_named(hardware.config.servos[0].model).number
    assert hardware.witness.registers(Register.MODEL_NUMBER) == [number] * hardware.config.dof
    assert (
        hardware.witness.registers(Register.OPERATING_MODE) == [POSITION_MODE] * hardware.config.dof
    )


def test_what_the_bus_measures_is_what_the_sdk_reads(hardware):
    with hardware.bus() as bus:
        bus.connect()
        assert hardware.read(bus) is BusStatus.OK
        measured_rad = bus.angle_rad.copy()
    model = model_named(hardware.config.servos[0].model)
    pulses = np.array(hardware.witness.registers(Register.PRESENT_POSITION))
    assert measured_rad == pytest.approx(
        (pulses - model.zero_pulse) * model.rad_per_pulse, abs=STILL_RAD
    )


def test_a_thousand_exchanges_pass_without_an_error(hardware):
    with hardware.bus() as bus:
        bus.connect()
        rows = []
        for _ in range(1000):
            hardware.read(bus)
            rows.append([*bus.angle_rad, *bus.current_a])
    assert np.ptp(np.array(rows)[:, : hardware.config.dof], axis=0).max() < STILL_RAD
    assert np.isfinite(rows).all()


def test_torque_goes_on_where_the_arm_stands_and_off_again(hardware):
    with hardware.bus() as bus:
        bus.connect()
        before_rad = bus.angle_rad.copy()
        bus.write(before_rad, hardware.clock.now_ns() + round(hardware.config.period_s * 1e9))
        assert bus.torque(True) is BusStatus.OK
        for _ in range(50):
            assert hardware.read(bus) is BusStatus.OK
        assert np.abs(bus.angle_rad - before_rad).max() < STILL_RAD, "it does not jump"
        assert bus.torque(False) is BusStatus.OK


def test_a_servo_that_hears_nothing_stops_listening_to_goals(hardware):
    model = model_named(hardware.config.servos[0].model)
    if Register.BUS_WATCHDOG not in model.table:
        pytest.skip(f"{model.name} has no bus watchdog")
    with hardware.bus() as bus:
        bus.connect()
        bus.write(bus.angle_rad, hardware.clock.now_ns() + round(hardware.config.period_s * 1e9))
        assert bus.torque(True) is BusStatus.OK
        hardware.clock.sleep_until(hardware.clock.now_ns() + SILENCE_NS)
        assert hardware.witness.registers(Register.BUS_WATCHDOG) == [TRIPPED] * hardware.config.dof
        assert bus.torque(False) is BusStatus.OK
    assert hardware.witness.registers(Register.BUS_WATCHDOG) == [0] * hardware.config.dof


def test_a_servo_that_is_not_there_is_named(hardware):
    ids = {servo.id for servo in hardware.config.servos}
    stranger = msgspec.structs.replace(hardware.config.servos[0], id=max(ids) + 100)
    hardware.config = msgspec.structs.replace(hardware.config, servos=(stranger,))
    try:
        with hardware.bus() as bus, pytest.raises(InputError, match=f"servo {stranger.id} "):
            bus.connect()
    finally:
        hardware.config = hardware.witness.config
