"""Bus and loop on real servos: every test leaves them without torque and without an error."""

import msgspec
import numpy as np
import pytest

from firmware_py.bus.registers import POSITION_MODE, Register
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.bus.servo_models import model_named
from firmware_py.safety.states import SafetyState
from firmware_py.summary import Ended
from tests.hitl.conftest import AMPLITUDE_RAD, RATE_RAD_S, REACH_RAD

pytestmark = pytest.mark.hitl

FOLLOWING_RAD = 0.05
"""How far the arm may be behind: its own lag at 0.15 rad/s, and a link that swings."""
SILENCE_NS = 500_000_000
TRIPPED = -1
STILL_RAD = 0.01
"""More than the quantisation and the trembling of a servo that stands."""


# --- bus ----------------------------------------------------------------------------------------


def test_the_servos_are_those_of_the_configuration_and_measure_what_the_sdk_reads(hardware):
    with hardware.bus() as bus:
        bus.connect()
        low, high = hardware.config.limits.angle_rad
        assert np.all((low <= bus.angle_rad) & (bus.angle_rad <= high)), "bring it to its zero"
        assert hardware.read(bus) is BusStatus.OK
        measured_rad = bus.angle_rad.copy()
    model = model_named(hardware.config.servos[0].model)
    assert set(hardware.registers(Register.MODEL_NUMBER)) == {model.number}
    assert set(hardware.registers(Register.OPERATING_MODE)) == {POSITION_MODE}
    pulses = np.array(hardware.registers(Register.PRESENT_POSITION))
    expected_rad = (pulses - model.zero_pulse) * model.rad_per_pulse
    assert measured_rad == pytest.approx(expected_rad, abs=STILL_RAD)


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
        bus.write(before_rad, hardware.deadline_ns())
        assert bus.torque(True) is BusStatus.OK
        for _ in range(50):
            assert hardware.read(bus) is BusStatus.OK
        assert np.abs(bus.angle_rad - before_rad).max() < STILL_RAD, "it does not jump"
        assert bus.torque(False) is BusStatus.OK


def test_a_servo_without_instructions_stops_at_its_watchdog(hardware):
    model = model_named(hardware.config.servos[0].model)
    if Register.BUS_WATCHDOG not in model.table:
        pytest.skip(f"{model.name} has no bus watchdog")
    with hardware.bus() as bus:
        bus.connect()
        bus.write(bus.angle_rad, hardware.deadline_ns())
        assert bus.torque(True) is BusStatus.OK
        hardware.clock.sleep_until(hardware.clock.now_ns() + SILENCE_NS)
        assert set(hardware.registers(Register.BUS_WATCHDOG)) == {TRIPPED}
        assert bus.torque(False) is BusStatus.OK
    assert set(hardware.registers(Register.BUS_WATCHDOG)) == {0}


# --- loop ---------------------------------------------------------------------------------------


def test_the_arm_follows_the_motion_from_where_it_stands_to_its_end(hardware):
    summary = hardware.run()
    assert (summary.ended, summary.released) == (Ended.FINISHED, True)
    goal_rad, angle_rad = hardware.column(summary, "goal"), hardware.column(summary, "angle")
    assert np.abs(goal_rad).max() == pytest.approx(AMPLITUDE_RAD, rel=0.01)
    assert np.abs(angle_rad).max() <= REACH_RAD
    assert np.ptp(angle_rad, axis=0).min() > AMPLITUDE_RAD, "it moves"
    assert np.abs(angle_rad[1:] - goal_rad[:-1]).max() < FOLLOWING_RAD
    steps_rad = np.abs(np.diff(np.vstack([angle_rad[:1], goal_rad]), axis=0))
    slots = summary.records["missed"].max() + 1
    assert steps_rad.max() <= RATE_RAD_S * hardware.config.period_s * slots
    assert (summary.records["stale_ticks"] == 0).all()


def test_a_stop_in_motion_brings_the_arm_to_rest_and_releases_it(hardware):
    summary = hardware.run(stop_at=80)
    assert (summary.ended, summary.reason) == (Ended.SIGNALLED, "SIGTERM")
    assert summary.released
    assert summary.ticks < 80 + 60, "at once, not at the motion's end"
    last_rad = hardware.column(summary, "goal")[-10:]
    assert np.ptp(last_rad, axis=0).max() == 0.0, "it holds its last goal"


def test_a_limit_stops_the_arm_and_releases_it(hardware):
    low_ceiling = msgspec.structs.replace(
        hardware.config.limits_in_force, tip_max_m=(1.2, 1.2, 0.5)
    )
    summary = hardware.run(low_ceiling)
    assert summary.ended is Ended.TRIPPED
    assert "the predicted tip has z" in summary.reason
    assert summary.released
    running = summary.records["state"] <= SafetyState.DEGRADED
    assert running.sum() <= low_ceiling.persistence_ticks
