"""The bus around the loop: checks at the start, goals, torque, closing and opening anew."""

import numpy as np
import pytest

from firmware_py.bus.dynamixel import DynamixelBus
from firmware_py.bus.registers import Register
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.bus.servo_models import MODELS
from firmware_py.bus.servo_setup import ServoSetup
from firmware_py.core.errors import InputError
from firmware_py.system.clock import SimClock
from tests.firmware_py.bus.tampered import (
    BUDGET_NS,
    LEGACY,
    PRO_A,
    SYNC_READ,
    XM,
    TamperedTransport,
    make,
    paced,
    read,
    with_error,
)


def test_goals_come_back_as_angles_and_currents_in_si_in_the_same_arrays(pair):
    bus, transport, clock = pair
    angle_rad, current_a = bus.angle_rad, bus.current_a
    goal_rad = np.array([0.25, -0.5])
    assert bus.write(goal_rad, clock.now_ns() + BUDGET_NS) is BusStatus.OK
    transport.put(2, Register.PRESENT_CURRENT, -100)
    assert read(bus, clock) is BusStatus.OK
    model = bus._servos[0].model
    assert np.all(np.abs(bus.angle_rad - goal_rad) <= model.rad_per_pulse / 2)
    assert bus.current_a.tolist() == [0.0, -100 * model.current_a_per_lsb]
    assert bus.angle_rad is angle_rad and bus.current_a is current_a


def test_a_servo_that_refuses_is_told_from_one_that_is_silent():
    bus, transport, clock = make(LEGACY)
    bus.connect()
    transport.tamper = lambda data: with_error(data, 7)
    assert read(bus, clock) is BusStatus.REFUSED
    assert not BusStatus.REFUSED.fresh


def test_a_port_that_is_gone_is_a_status_until_it_is_back(pair):
    bus, transport, clock = pair
    bus.torque(True)
    transport.gone = True
    assert read(bus, clock) is BusStatus.PORT_GONE
    assert bus.write(np.zeros(2), clock.now_ns() + BUDGET_NS) is BusStatus.PORT_GONE
    bus.close()
    assert not bus.reopen(), "without an opener it stays gone"
    transport.gone = False
    assert read(bus, clock) is BusStatus.OK


@pytest.mark.parametrize("goal", [np.nan, np.inf, 1e9])
def test_a_goal_that_cannot_be_sent_never_leaves(goal):
    bus, transport, clock = make(LEGACY)
    bus.connect()
    sent = len(transport.written)
    with pytest.raises(ValueError):
        bus.write(np.array([goal]), clock.now_ns() + BUDGET_NS)
    assert len(transport.written) == sent


def test_connecting_leaves_torque_off_and_a_tripped_watchdog_cleared():
    bus, transport, _ = make(PRO_A, PRO_A)
    for id_ in (1, 2):
        transport.put(id_, Register.TORQUE_ENABLE, 1)
        transport.put(id_, Register.BUS_WATCHDOG, -1)
    bus.connect()
    for id_ in (1, 2):
        assert transport.get(id_, Register.TORQUE_ENABLE) == 0
        assert transport.get(id_, Register.BUS_WATCHDOG) == 0


@pytest.mark.parametrize(("period_s", "units"), [(0.017, 3), (0.020, 3), (0.030, 5), (0.004, 1)])
def test_torque_arms_a_watchdog_of_at_least_three_periods(period_s, units):
    bus, transport, _ = make(PRO_A, PRO_A, period_s=period_s)
    bus.connect()
    assert bus.torque(True) is BusStatus.OK
    assert [transport.get(id_, Register.TORQUE_ENABLE) for id_ in (1, 2)] == [1, 1]
    assert [transport.get(id_, Register.BUS_WATCHDOG) for id_ in (1, 2)] == [units, units]
    bus.close()
    assert [transport.get(id_, Register.TORQUE_ENABLE) for id_ in (1, 2)] == [0, 0]
    assert [transport.get(id_, Register.BUS_WATCHDOG) for id_ in (1, 2)] == [0, 0]


def test_torque_off_reaches_the_second_servo_though_the_first_is_silent():
    bus, transport, _ = make(LEGACY, LEGACY)
    bus.connect()
    bus.torque(True)
    transport.tamper = lambda data: b"" if data[4:5] == b"\x01" else data
    assert bus.torque(False) is BusStatus.TIMEOUT
    assert transport.get(2, Register.TORQUE_ENABLE) == 0


@pytest.mark.parametrize(
    ("register", "raw", "words"),
    [
        (Register.MODEL_NUMBER, 54025, "servo 1 is H54-200-S500-R.A., not H54-200-S500-R"),
        (Register.MODEL_NUMBER, 7, "servo 1 is model number 7"),
        (Register.HARDWARE_ERROR, 0b100, "overheating"),
        (Register.OPERATING_MODE, 1, "operating mode 1"),
        (Register.MAX_POSITION_LIMIT, 1000, "allows -3.142 to 0.013 rad"),
    ],
)
def test_a_servo_that_is_unfit_is_named_with_what_is_wrong(register, raw, words):
    bus, transport, _ = make(LEGACY)
    transport.put(1, register, raw)
    with pytest.raises(InputError, match=words):
        bus.connect()


def test_a_silent_servo_is_named():
    bus, transport, _ = make(LEGACY, LEGACY)
    transport.tamper = lambda data: b"" if data[4:5] == b"\x02" else data
    with pytest.raises(InputError, match="servo 2 gives no valid answer"):
        bus.connect()


def test_families_are_not_mixed_on_one_bus():
    with pytest.raises(InputError, match="legacy PRO"):
        make(LEGACY, PRO_A)


def test_the_return_delay_is_written_only_where_it_differs():
    bus, transport, _ = make(LEGACY, LEGACY, return_delay_s=20e-6)
    transport.put(1, Register.RETURN_DELAY, 250)
    transport.put(2, Register.RETURN_DELAY, 10)
    bus.connect()
    assert [transport.get(id_, Register.RETURN_DELAY) for id_ in (1, 2)] == [10, 10]
    # A write is 12 bytes and the data; EEPROM wears out, so nothing is written without need.
    writes = [w for w in transport.written if w[7] == 3 and w[8:10] == b"\x09\x00"]
    assert [w[4] for w in writes] == [1]


def test_an_adapter_that_is_too_slow_for_the_loop_is_refused_at_the_start():
    class SlowTransport(TamperedTransport):
        def read(self, size, deadline_ns):
            self.clock.advance(16_000_000 if size else 0)
            return super().read(size, deadline_ns)

    clock = SimClock()
    models = {1: MODELS[PRO_A]}
    setups = [ServoSetup(1, models[1], -0.6, 0.6)]
    for allowed_s, refused in ((0.0161, False), (0.008, True)):
        bus = DynamixelBus(
            SlowTransport(models, clock), setups, clock, period_s=0.05, reply_timeout_s=allowed_s
        )
        if refused:
            with pytest.raises(InputError, match=r"answers take 16\.0 ms.*latency timer"):
                bus.connect()
        else:
            bus.connect()


@pytest.mark.parametrize(("number", "limited"), [(LEGACY, True), (PRO_A, False), (XM, False)])
def test_a_servo_without_a_watchdog_keeps_the_speed_limit_itself(number, limited):
    clock, models = SimClock(), {1: MODELS[number]}
    transport = TamperedTransport(models, clock)
    bus = DynamixelBus(transport, [ServoSetup(1, models[1], -0.6, 0.6, 2.0)], clock, period_s=0.017)
    bus.connect()
    raw = transport.get(1, Register.PROFILE_VELOCITY)
    lsb = models[1].velocity_rad_s_per_lsb
    assert (2.0 <= raw * lsb < 2.0 + lsb) if limited else raw == 0


def test_a_port_that_is_back_is_opened_anew():
    clock, models = SimClock(), {1: MODELS[PRO_A]}
    transports = [TamperedTransport(models, clock)]
    closed = []

    def opener():
        if len(transports) < 2:
            raise InputError("port", "is missing", "plug it in")
        return transports[-1]

    transports[0].close = lambda: closed.append(0)
    setups = [ServoSetup(1, models[1], -0.6, 0.6)]
    bus = DynamixelBus(transports[0], setups, clock, period_s=0.017, opener=opener)
    bus.connect()
    transports[0].gone = True
    assert read(bus, clock) is BusStatus.PORT_GONE
    assert not bus.reopen()
    transports.append(TamperedTransport(models, clock))
    assert bus.reopen()
    bus.connect()
    assert read(bus, clock) is BusStatus.OK
    assert closed


def test_an_answer_lost_at_the_start_does_not_refuse_the_servos():
    _, transport, clock = paced()
    setups = [ServoSetup(id_, MODELS[LEGACY], -0.6, 0.6) for id_ in (1, 2)]
    bus = DynamixelBus(transport, setups, clock, period_s=0.017)
    read, syncs = transport.read, []

    def lose_the_first_measurement(size, deadline_ns):
        if size and transport.written[-1][7] == SYNC_READ and not syncs:
            syncs.append(0)
            transport.fates = ("lost",)
        return read(size, deadline_ns)

    transport.read = lose_the_first_measurement
    bus.connect()
    assert syncs
    assert bus.read(clock.now_ns() + BUDGET_NS) is BusStatus.OK


def test_servos_that_are_connected_anew_start_without_the_old_alert():
    bus, transport, clock = make(PRO_A)
    bus.connect()
    bus.torque(True)
    transport.put(1, Register.TORQUE_ENABLE, 0)
    assert read(bus, clock) is BusStatus.ALERT
    bus.connect()
    assert (read(bus, clock), bus.alert) == (BusStatus.OK, 0)
