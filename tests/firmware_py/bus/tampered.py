"""Servos in memory whose answers are tampered with, late or lost."""

from firmware_py.bus import codec
from firmware_py.bus.dynamixel import DynamixelBus
from firmware_py.bus.loopback import LoopbackTransport
from firmware_py.bus.servo_models import MODELS
from firmware_py.bus.servo_setup import ServoSetup
from firmware_py.system.clock import SimClock

LEGACY, PRO_A, XM = 54024, 54025, 1020
BUDGET_NS = 8_000_000
EXCHANGE_NS, MARGIN_NS = 1_500_000, 2_000_000
SYNC_READ = 0x82


class TapeTransport:
    """Plays bytes, and is silent until the deadline after them."""

    def __init__(self, clock, *plays):
        self.clock, self.plays = clock, list(plays)

    def read(self, size, deadline_ns):
        if not self.plays:
            self.clock.sleep_until(deadline_ns)
            return b""
        return self.plays.pop(0)

    def write(self, data):
        return len(data)

    def discard_input(self):
        pass

    def close(self):
        pass


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


def make(*numbers, period_s=0.017, limits=(-0.6, 0.6), transport_type=TamperedTransport, **options):
    """A bus of servos in memory that is not connected yet, its transport and its clock.

    `limits`: the rest of `ServoSetup`, from the lowest angle on.
    """
    clock = SimClock()
    models = {id_: MODELS[number] for id_, number in enumerate(numbers, start=1)}
    transport = transport_type(models, clock)
    setups = [ServoSetup(id_, model, *limits) for id_, model in models.items()]
    return DynamixelBus(transport, setups, clock, period_s=period_s, **options), transport, clock


def read(bus, clock):
    return bus.read(clock.now_ns() + BUDGET_NS)


def flip_payload(data):
    return bytes([*data[:11], data[11] ^ 1, *data[12:]])


def with_error(frame, error, at=8):
    """A whole packet with another error byte."""
    frame = frame[:at] + bytes([error]) + frame[at + 1 : -2]
    return frame + codec.crc16(frame).to_bytes(2, "little")


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
    bus, transport, clock = make(LEGACY, LEGACY, transport_type=PacedTransport)
    bus.connect()
    return bus, transport, clock
