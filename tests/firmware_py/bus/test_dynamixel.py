"""The bus around the loop: checks at the start, goals, torque, closing and opening anew."""

import math

import numpy as np
import pytest

from firmware_py.bus.codec import Instruction
from firmware_py.bus.dynamixel import DynamixelBus
from firmware_py.bus.registers import Register
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.bus.servo_models import MODELS
from firmware_py.bus.servo_setup import AssumedSettings, ServoSetup
from firmware_py.core.errors import InputError
from tests.firmware_py.bus.tampered import (
    BUDGET_NS,
    LEGACY,
    PRO_A,
    XM,
    TamperedTransport,
    make,
    paced,
    read,
)


def registers(transport, register):
    return [transport.get(id_, register) for id_ in transport.memory]


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


@pytest.mark.parametrize("goal", [np.nan, np.inf, 1e9])
def test_a_goal_that_cannot_be_sent_never_leaves(goal):
    bus, transport, clock = make(LEGACY)
    bus.connect()
    sent = len(transport.written)
    with pytest.raises(ValueError):
        bus.write(np.array([goal]), clock.now_ns() + BUDGET_NS)
    assert len(transport.written) == sent


def test_connecting_switches_torque_off_and_clears_a_tripped_watchdog():
    bus, transport, _ = make(PRO_A, PRO_A)
    for id_ in (1, 2):
        transport.put(id_, Register.TORQUE_ENABLE, 1)
        transport.put(id_, Register.BUS_WATCHDOG, -1)
    bus.connect()
    assert registers(transport, Register.TORQUE_ENABLE) == [0, 0]
    assert registers(transport, Register.BUS_WATCHDOG) == [0, 0]


@pytest.mark.parametrize(
    ("period_s", "units"), [(0.017, 3), (0.020, 3), (0.030, 5), (0.004, 1), (0.846, 127)]
)
def test_torque_arms_a_watchdog_of_at_least_three_periods(period_s, units):
    bus, transport, _ = make(PRO_A, PRO_A, period_s=period_s)
    bus.connect()
    assert bus.torque(True) is BusStatus.OK
    assert registers(transport, Register.TORQUE_ENABLE) == [1, 1]
    assert registers(transport, Register.BUS_WATCHDOG) == [units, units]
    bus.close()
    assert registers(transport, Register.TORQUE_ENABLE) == [0, 0]
    assert registers(transport, Register.BUS_WATCHDOG) == [0, 0]


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


def test_a_mixture_of_families_is_refused():
    with pytest.raises(InputError, match="legacy PRO"):
        make(LEGACY, PRO_A)


def test_the_return_delay_is_written_only_where_it_differs():
    bus, transport, _ = make(LEGACY, LEGACY, return_delay_s=20e-6)
    transport.put(1, Register.RETURN_DELAY, 250)
    transport.put(2, Register.RETURN_DELAY, 10)
    bus.connect()
    assert registers(transport, Register.RETURN_DELAY) == [10, 10]
    # A write is 12 bytes and the data; EEPROM wears out, so nothing is written without need.
    writes = [w for w in transport.written if w[7] == 3 and w[8:10] == b"\x09\x00"]
    assert [w[4] for w in writes] == [1]


@pytest.mark.parametrize(("allowed_s", "refused"), [(0.0161, False), (0.008, True)])
def test_an_adapter_that_is_too_slow_for_the_loop_is_refused_at_the_start(
    allowed_s, refused, monkeypatch
):
    bus, transport, clock = make(PRO_A, period_s=0.05, reply_timeout_s=allowed_s)
    answer = transport.read

    def slow(size, deadline_ns):
        clock.advance(16_000_000 if size else 0)
        return answer(size, deadline_ns)

    monkeypatch.setattr(transport, "read", slow)
    if refused:
        with pytest.raises(InputError, match=r"answers take 16\.0 ms.*latency timer"):
            bus.connect()
    else:
        bus.connect()


@pytest.mark.parametrize(("number", "limited"), [(LEGACY, True), (PRO_A, False), (XM, False)])
def test_a_servo_without_a_watchdog_limits_its_speed_itself(number, limited):
    bus, transport, _ = make(number, limits=(-0.6, 0.6, 2.0))
    transport.put(1, Register.PROFILE_ACCELERATION, 5)  # of an earlier program
    transport.put(1, Register.PROFILE_VELOCITY, 7)
    bus.connect()
    assert transport.get(1, Register.PROFILE_ACCELERATION) == 0
    raw = transport.get(1, Register.PROFILE_VELOCITY)
    lsb = bus._servos[0].model.velocity_rad_s_per_lsb
    assert (2.0 <= raw * lsb < 2.0 + lsb) if limited else raw == 0


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


def test_a_port_that_is_back_is_opened_anew():
    transports, closed = [], []

    def opener():
        if len(transports) < 2:
            raise InputError("port", "is missing", "plug it in")
        return transports[-1]

    bus, transport, clock = make(PRO_A, opener=opener)
    transports.append(transport)
    transport.close = lambda: closed.append(0)
    bus.connect()
    transport.gone = True
    assert read(bus, clock) is BusStatus.PORT_GONE
    assert not bus.reopen()
    transports.append(TamperedTransport({1: bus._servos[0].model}, clock))
    assert bus.reopen()
    bus.connect()
    assert read(bus, clock) is BusStatus.OK
    assert closed


def test_servos_that_are_connected_anew_start_without_the_old_alert():
    bus, transport, clock = make(PRO_A)
    bus.connect()
    bus.torque(True)
    transport.put(1, Register.TORQUE_ENABLE, 0)
    assert read(bus, clock) is BusStatus.ALERT
    bus.connect()
    assert (read(bus, clock), bus.alert) == (BusStatus.OK, 0)


# --- settings of a servo that the plant assumes ---------------------------------------------------


ALL = pytest.mark.parametrize("number", [LEGACY, PRO_A, XM])
NEW = pytest.mark.parametrize("number", [PRO_A, XM])


def servo(number, settings=None, **changed):
    """A bus with one servo whose registers are changed."""
    rest = (-0.6, 0.6, math.inf, settings or AssumedSettings())
    bus, transport, _ = make(number, limits=rest)
    for name, raw in changed.items():
        transport.put(1, Register[name], raw)
    return bus, transport


def refusal(number, settings=None, **changed):
    bus, _ = servo(number, settings, **changed)
    with pytest.raises(InputError) as raised:
        bus.connect()
    return str(raised.value)


@NEW
def test_a_drive_mode_that_is_not_declared_is_refused(number):
    for mode in (1, 8):
        assert f"Drive Mode {mode}" in refusal(number, DRIVE_MODE=mode)
    reverse = AssumedSettings(reverse=True)
    servo(number, reverse, DRIVE_MODE=1)[0].connect()
    assert "Drive Mode 0" in refusal(number, reverse)


@ALL
def test_a_homing_offset_that_is_not_declared_is_refused(number):
    for raw in (-2, 1000):
        assert "Homing Offset" in refusal(number, HOMING_OFFSET=raw)
    offset_rad = 1000.4 * MODELS[number].rad_per_pulse
    settings = AssumedSettings(homing_offset_rad=offset_rad)
    servo(number, settings, HOMING_OFFSET=1000)[0].connect()
    assert "Homing Offset" in refusal(number, settings, HOMING_OFFSET=998)
    assert "Homing Offset" in refusal(number, settings)


@ALL
@pytest.mark.parametrize("gain", ["POSITION_P_GAIN", "VELOCITY_P_GAIN", "VELOCITY_I_GAIN"])
def test_gains_other_than_those_of_the_plant_are_refused(number, gain):
    settings = AssumedSettings(gains={Register[gain]: 640})
    servo(number, settings, **{gain: 640})[0].connect()
    words = refusal(number, settings, **{gain: 641})
    assert all(word in words for word in (Register[gain].value, "641", "640"))


@ALL
def test_a_servo_that_answers_only_a_ping_differs_from_one_without_power(number):
    for level in (0, 1):
        words = refusal(number, STATUS_RETURN_LEVEL=level)
        assert f"Status Return Level {level}" in words
    bus, transport = servo(number)
    ping = 14  # bytes of its answer
    transport.tamper = lambda data: data if len(data) == ping else b""
    with pytest.raises(InputError, match=r"answers a ping but no read.*Status Return Level is 0"):
        bus.connect()
    transport.tamper = lambda data: b""
    with pytest.raises(InputError, match="check its power"):
        bus.connect()


# --- torque off -----------------------------------------------------------------------------------


class FailingTransport(TamperedTransport):
    """Loses the first torque-off to each servo, or servos confirm torque off and stay on."""

    loses = broken = False
    late = b""
    """Answers to an earlier read that come instead of the lost confirmation."""

    def __init__(self, models, clock):
        super().__init__(models, clock)
        self.sent = dict.fromkeys(models, 0)
        self._torque = next(iter(models.values())).table[Register.TORQUE_ENABLE].address

    def write(self, data):
        is_write = data[7] == Instruction.WRITE
        address, content = int.from_bytes(data[8:10], "little"), data[10:-2]
        if self.loses and is_write and (address, content) == (self._torque, b"\0"):
            self.sent[data[4]] += 1
            if self.sent[data[4]] == 1:
                self._answers += self.late
                return len(data)
        return super().write(data)

    def _store(self, id_, address, data):
        if not (self.broken and (address, data) == (self._torque, b"\0")):
            super()._store(id_, address, data)


def driven(number):
    bus, transport, clock = make(number, number, transport_type=FailingTransport)
    bus.connect()
    assert bus.torque(True) is BusStatus.OK
    return bus, transport, clock


@pytest.mark.parametrize("number", [LEGACY, PRO_A, XM])
def test_a_late_answer_to_a_read_confirms_no_torque_off(number):
    bus, transport, clock = driven(number)
    late = []
    transport.tamper = lambda data: late.append(data) or b""
    assert not bus.read(clock.now_ns() + 8_000_000).fresh
    transport.tamper, transport.late, transport.loses = lambda data: data, late[0], True
    assert len(late[0]) > 22
    assert bus.torque(False) is BusStatus.OK
    assert registers(transport, Register.TORQUE_ENABLE) == [0, 0]
    assert transport.sent == {1: 2, 2: 2}


@pytest.mark.parametrize("number", [LEGACY, PRO_A])
def test_a_servo_that_confirms_but_stays_on_is_not_released(number):
    bus, transport, _ = driven(number)
    transport.broken = True
    assert bus.torque(False) is BusStatus.TIMEOUT
    assert registers(transport, Register.TORQUE_ENABLE) == [1, 1]
    transport.broken = False
    bus.close()
    assert registers(transport, Register.TORQUE_ENABLE) == [0, 0], "it is tried again at the end"


def test_a_servo_that_answers_no_read_is_not_released():
    bus, transport, _ = driven(LEGACY)
    transport.tamper = lambda data: data if len(data) == 11 else b""
    assert bus.torque(False) is BusStatus.TIMEOUT


def test_an_answer_lost_at_the_start_does_not_refuse_the_servos():
    _, transport, clock = paced()
    setups = [ServoSetup(id_, MODELS[LEGACY], -0.6, 0.6) for id_ in (1, 2)]
    bus = DynamixelBus(transport, setups, clock, period_s=0.017)
    read_bytes, lost = transport.read, []

    def lose_the_first_measurement(size, deadline_ns):
        if size and transport.written[-1][7] == Instruction.SYNC_READ and not lost:
            lost.append(size)
            transport.fates = ("lost",)
        return read_bytes(size, deadline_ns)

    transport.read = lose_the_first_measurement
    bus.connect()
    assert lost
    assert bus.read(clock.now_ns() + BUDGET_NS) is BusStatus.OK
