"""Faults of line and servos as values, against servos in memory with tampered answers."""

import numpy as np
import pytest

from firmware_py.bus.dynamixel import DynamixelBus, ServoSetup
from firmware_py.bus.loopback import LoopbackTransport
from firmware_py.bus.registers import STOPPED_BY_WATCHDOG, TORQUE_LOST, Register
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.bus.servo_models import MODELS, model_named
from firmware_py.errors import InputError
from firmware_py.realtime.clock import SimClock

LEGACY, PRO_A, XM = 54024, 54025, 1020
BUDGET_NS = 8_000_000


class TamperedTransport(LoopbackTransport):
    """A loopback whose answers pass through a function; silence lasts until the deadline."""

    def __init__(self, models, clock):
        super().__init__(models)
        self.clock, self.tamper, self.written = clock, lambda data: data, []
        self.gone = False

    def write(self, data):
        self.check()
        self.written.append(bytes(data))
        return super().write(data)

    def read(self, size, deadline_ns):
        self.check()
        data = super().read(size, deadline_ns)
        data = self.tamper(data) if data else b""
        if not data:
            self.clock.sleep_until(deadline_ns)
        return data

    def check(self):
        if self.gone:
            raise OSError(5, "Input/output error")


def make(*numbers, period_s=0.017, limits=(-0.6, 0.6), **options):
    clock = SimClock()
    models = {id_: MODELS[number] for id_, number in enumerate(numbers, start=1)}
    transport = TamperedTransport(models, clock)
    setups = [ServoSetup(id_, model, *limits) for id_, model in models.items()]
    return DynamixelBus(transport, setups, clock, period_s=period_s, **options), transport, clock


@pytest.fixture(params=[LEGACY, PRO_A, XM], ids=lambda n: MODELS[n].table.name)
def pair(request):
    bus, transport, clock = make(request.param, request.param)
    bus.connect()
    return bus, transport, clock


def read(bus, clock):
    return bus.read(clock.now_ns() + BUDGET_NS)


def test_goals_come_back_as_angles_and_currents_in_si(pair):
    bus, transport, clock = pair
    goal_rad = np.array([0.25, -0.5])
    assert bus.write(goal_rad, clock.now_ns() + BUDGET_NS) is BusStatus.OK
    transport.put(2, Register.PRESENT_CURRENT, -100)
    assert read(bus, clock) is BusStatus.OK
    model = bus._servos[0].model
    assert np.all(np.abs(bus.angle_rad - goal_rad) <= model.rad_per_pulse / 2)
    assert bus.current_a.tolist() == [0.0, -100 * model.current_a_per_lsb]


def test_arrays_are_overwritten_in_place(pair):
    bus, _, clock = pair
    angle_rad, current_a = bus.angle_rad, bus.current_a
    bus.write(np.array([0.1, 0.2]), clock.now_ns() + BUDGET_NS)
    read(bus, clock)
    assert bus.angle_rad is angle_rad
    assert bus.current_a is current_a
    assert angle_rad[1] > 0.19


def drop_second(data):
    return data[: len(data) // 2]


def flip_payload(data):
    return bytes([*data[:11], data[11] ^ 1, *data[12:]])


def cut(data):
    return data[:-3]


@pytest.mark.parametrize(
    ("tamper", "expected"),
    [
        (lambda data: b"", BusStatus.TIMEOUT),
        (drop_second, None),
        (flip_payload, BusStatus.CORRUPT),
        (cut, BusStatus.CORRUPT),
    ],
)
def test_a_bad_answer_is_a_status_and_leaves_the_last_good_data(pair, tamper, expected):
    bus, transport, clock = pair
    bus.write(np.array([0.3, 0.4]), clock.now_ns() + BUDGET_NS)
    assert read(bus, clock) is BusStatus.OK
    before = bus.angle_rad.copy()
    assert before.all(), "zeros would hide the zeros that the SDK returns"
    bus.write(np.array([0.1, 0.2]), clock.now_ns() + BUDGET_NS)
    transport.tamper = tamper
    if expected is None:  # half of a common packet, or the first of two
        expected = BusStatus.CORRUPT if bus.plan.fast else BusStatus.TIMEOUT
    start_ns = clock.now_ns()
    assert read(bus, clock) is expected
    assert clock.now_ns() - start_ns <= BUDGET_NS
    assert bus.angle_rad.tolist() == before.tolist()
    transport.tamper = lambda data: data
    assert read(bus, clock) is BusStatus.OK
    assert bus.angle_rad[0] == pytest.approx(0.1, abs=1e-3)


@pytest.mark.parametrize("noise", [b"\x00", b"\xff\xff", b"\xff\xff\xfd\x00", bytes(range(40))])
def test_noise_in_front_of_the_answers_does_no_harm(pair, noise):
    bus, transport, clock = pair
    transport.tamper = lambda data: noise + data
    assert read(bus, clock) in (BusStatus.OK, BusStatus.CORRUPT, BusStatus.TIMEOUT)
    transport.tamper = lambda data: data
    assert read(bus, clock) is BusStatus.OK


def test_answers_in_any_order_doubled_or_from_a_stranger_are_told_apart():
    bus, transport, clock = make(LEGACY, LEGACY)
    _, transport_of_stranger, _ = make(LEGACY, LEGACY, LEGACY)
    bus.connect()
    bus.write(np.array([0.1, 0.2]), clock.now_ns() + BUDGET_NS)
    size, (low, high) = bus.plan.block.size, divmod(bus.plan.block.address, 256)[::-1]
    transport_of_stranger._execute([0, 0, 0, 0, 254, 0, 0, 0x82, low, high, size, 0, 3, 0, 0])
    strange, each = transport_of_stranger._answers, 11 + size
    transport.tamper = lambda data: strange + data[each:] + data[each:] + data[:each]
    assert read(bus, clock) is BusStatus.OK
    assert bus.angle_rad == pytest.approx([0.1, 0.2], abs=1e-4)


def test_the_alert_bit_is_kept_and_its_cause_read_once():
    bus, transport, clock = make(LEGACY, LEGACY)
    bus.connect()
    transport.put(2, Register.HARDWARE_ERROR, 0b100000)
    packets, size = transport._packets, 11 + bus.plan.block.size

    def alert(data):
        out = b""
        for k in range(0, len(data), size):
            frame = list(data[k : k + size])
            if len(frame) == size and frame[4] == 2:
                frame[8] |= 0x80
                crc = packets.updateCRC(0, frame, size - 2)
                frame[-2:] = [crc & 0xFF, crc >> 8]
            out += bytes(frame)
        return out

    transport.tamper = alert
    assert read(bus, clock) is BusStatus.ALERT
    assert BusStatus.ALERT.fresh
    assert bus.alert == 0b100000
    sent = len(transport.written)
    assert read(bus, clock) is BusStatus.ALERT
    assert len(transport.written) == sent + 1


def test_a_servo_that_refuses_is_told_from_one_that_is_silent():
    bus, transport, clock = make(LEGACY)
    bus.connect()

    def refuse(data):
        frame = list(data)
        frame[8] = 7
        crc = transport._packets.updateCRC(0, frame, len(frame) - 2)
        return bytes([*frame[:-2], crc & 0xFF, crc >> 8])

    transport.tamper = refuse
    assert read(bus, clock) is BusStatus.REFUSED
    assert not BusStatus.REFUSED.fresh


def test_a_port_that_is_gone_is_a_status_until_it_is_back(pair):
    bus, transport, clock = pair
    transport.gone = True
    assert read(bus, clock) is BusStatus.PORT_GONE
    assert bus.write(np.zeros(2), clock.now_ns() + BUDGET_NS) is BusStatus.PORT_GONE
    transport.gone = False
    assert read(bus, clock) is BusStatus.OK


def test_the_goal_whose_bytes_look_like_a_header_arrives():
    bus, transport, clock = make(LEGACY)
    bus.connect()
    goal = model_named("H54-200-S500-R").angle_rad(-131073)
    bus.write(np.array([goal]), clock.now_ns() + BUDGET_NS)
    transport.read(0, 0)
    assert transport.get(1, Register.GOAL_POSITION) == -131073


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


def test_closing_a_dead_port_raises_nothing():
    bus, transport, _ = make(LEGACY)
    bus.connect()
    bus.torque(True)
    transport.gone = True
    bus.close()


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
    with pytest.raises(InputError, match="servo 2 gives no good answer"):
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


# --- late answers, slow adapters, servos without a watchdog, ports that come back ----------------


@pytest.mark.parametrize("late_by", [1, 2, 3])
def test_the_answer_to_an_earlier_read_is_never_taken_for_this_one(pair, late_by):
    """It arrives behind the next instruction, whole and undamaged, in front of the real one."""
    bus, transport, clock = pair
    held = []
    transport.tamper = lambda data: held.append(data) or b""
    for k in range(late_by):
        bus.write(np.full(2, 0.1 * (k + 1)), clock.now_ns() + BUDGET_NS)
        assert read(bus, clock) is BusStatus.TIMEOUT
    transport.tamper = lambda data: b"".join(held) + data
    bus.write(np.full(2, 0.5), clock.now_ns() + BUDGET_NS)
    assert read(bus, clock) is BusStatus.OK
    assert bus.angle_rad == pytest.approx([0.5, 0.5], abs=1e-3)


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


def test_without_an_opener_a_port_stays_gone(pair):
    assert not pair[0].reopen()


# --- the second read of a tick -------------------------------------------------------------------

EXCHANGE_NS, MARGIN_NS = 1_500_000, 2_000_000
SYNC_READ = 0x82


class PacedTransport(TamperedTransport):
    """Answers take their time; some reads are never answered, or damaged at once."""

    pace_ns, fates = EXCHANGE_NS, ()

    def read(self, size, deadline_ns):
        if not size:  # what is discarded takes no time
            return super().read(size, deadline_ns)
        fate, self.fates = (self.fates[0], self.fates[1:]) if self.fates else ("", ())
        if fate == "lost":
            self.discard_input()
            self.clock.sleep_until(deadline_ns)
            return b""
        self.clock.advance(self.pace_ns)
        data = super().read(size, deadline_ns)
        return flip_payload(data) if fate == "damaged" else data


def paced():
    clock, models = SimClock(), {1: MODELS[LEGACY], 2: MODELS[LEGACY]}
    transport = PacedTransport(models, clock)
    setups = [ServoSetup(id_, model, -0.6, 0.6) for id_, model in models.items()]
    bus = DynamixelBus(transport, setups, clock, period_s=0.017)
    bus.connect()
    return bus, transport, clock


@pytest.mark.parametrize(
    ("budget_ns", "expected"),
    [
        (8_000_000, BusStatus.RETRIED),
        (2 * EXCHANGE_NS + MARGIN_NS, BusStatus.RETRIED),
        (2 * EXCHANGE_NS + MARGIN_NS - 1, BusStatus.TIMEOUT),
    ],
)
def test_a_lost_answer_is_asked_for_again_where_both_reads_fit(budget_ns, expected):
    bus, transport, clock = paced()
    transport.fates, start_ns, sent = ("lost",), clock.now_ns(), len(transport.written)
    assert bus.read(start_ns + budget_ns) is expected
    again = expected is BusStatus.RETRIED
    assert len(transport.written) - sent == 1 + again
    taken_ns = budget_ns - MARGIN_NS if again else budget_ns
    assert clock.now_ns() - start_ns == taken_ns, "a single read has all the time"


@pytest.mark.parametrize(("short_ns", "again"), [(0, True), (1, False)])
def test_a_damaged_answer_is_asked_for_again_at_once_where_time_is_left(short_ns, again):
    bus, transport, clock = paced()
    transport.fates, start_ns, sent = ("damaged",), clock.now_ns(), len(transport.written)
    status = bus.read(start_ns + 2 * EXCHANGE_NS - short_ns)
    assert status is (BusStatus.RETRIED if again else BusStatus.CORRUPT)
    assert len(transport.written) - sent == 1 + again


def test_a_read_is_repeated_once_and_no_more():
    bus, transport, clock = paced()
    transport.fates, start_ns, sent = ("damaged",) * 3, clock.now_ns(), len(transport.written)
    assert bus.read(start_ns + 100_000_000) is BusStatus.CORRUPT
    assert len(transport.written) - sent == 2


def test_a_port_that_is_gone_is_not_asked_again():
    bus, transport, clock = paced()
    calls = []
    transport.check = lambda: calls.append(0) or (_ for _ in ()).throw(OSError(5, "gone"))
    assert bus.read(clock.now_ns() + BUDGET_NS) is BusStatus.PORT_GONE
    assert len(calls) == 1


def test_an_alert_in_the_second_read_stops_the_robot_all_the_same():
    bus, transport, clock = paced()
    transport.put(1, Register.HARDWARE_ERROR, 0b100)

    def alert(data):
        if len(data) < 30 or transport.fates:  # the answers of both servos
            return data
        frame = list(data[: len(data) // 2])
        frame[8] |= 0x80
        crc = transport._packets.updateCRC(0, frame, len(frame) - 2)
        return bytes([*frame[:-2], crc & 0xFF, crc >> 8]) + data[len(data) // 2 :]

    transport.fates, transport.tamper = ("lost",), alert
    assert bus.read(clock.now_ns() + BUDGET_NS) is BusStatus.ALERT
    assert bus.alert == 0b100


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


# --- servos that do not drive --------------------------------------------------------------------


@pytest.mark.parametrize("joint", [1, 2])
@pytest.mark.parametrize(
    ("register", "raw", "number", "bits"),
    [(Register.TORQUE_ENABLE, 0, LEGACY, TORQUE_LOST),
     (Register.TORQUE_ENABLE, 0, PRO_A, TORQUE_LOST),
     (Register.BUS_WATCHDOG, -1, PRO_A, STOPPED_BY_WATCHDOG)],
)  # fmt: skip
def test_a_servo_that_does_not_drive_says_so_in_the_next_read(register, raw, number, bits, joint):
    bus, transport, clock = make(number, number)
    bus.connect()
    bus.torque(True)
    assert read(bus, clock) is BusStatus.OK
    transport.put(joint, register, raw)
    assert (read(bus, clock), bus.alert) == (BusStatus.ALERT, bits)
    assert len(transport.written[-1]) == len(transport.written[-2]), "nothing was asked besides"


def test_a_torque_that_was_never_switched_on_is_no_alert(pair):
    bus, transport, clock = pair
    assert (read(bus, clock), bus.alert) == (BusStatus.OK, 0)
    bus.torque(True)
    bus.torque(False)
    assert (read(bus, clock), bus.alert) == (BusStatus.OK, 0)
    transport.tamper = lambda data: b""
    bus.torque(True)  # no servo confirms
    transport.tamper = lambda data: data
    transport.put(1, Register.TORQUE_ENABLE, 0)
    assert (read(bus, clock), bus.alert) == (BusStatus.OK, 0)


def test_servos_that_are_connected_anew_start_without_the_old_alert():
    bus, transport, clock = make(PRO_A)
    bus.connect()
    bus.torque(True)
    transport.put(1, Register.TORQUE_ENABLE, 0)
    assert read(bus, clock) is BusStatus.ALERT
    bus.connect()
    assert (read(bus, clock), bus.alert) == (BusStatus.OK, 0)


def test_a_servo_whose_block_lacks_its_torque_is_not_asked_for_it():
    bus, transport, clock = make(XM)
    bus.connect()
    bus.torque(True)
    transport.put(1, Register.TORQUE_ENABLE, 0)
    assert (read(bus, clock), bus.plan.indirect) == (BusStatus.OK, False)
