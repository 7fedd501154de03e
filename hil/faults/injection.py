"""Injection of faults into line and servos: a plan sets kind and number, the seed sets the time.

An exchange is one synchronous read of the loop; they are counted from the time of torque on.
"""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from firmware_py.bus import codec
from hil.emulator.line_faults import UNHEARD, FaultPlan
from hil.faults.servo_log import LoggedServo

FOREVER: Final = 1_000_000
FIRST_EXCHANGE: Final = (40, 110)
"""Range from which the seed draws the first exchange with a fault. The arm moves during it."""

_FOREIGN_ID: Final = 77
_LENGTH_BYTES, _BODY_START, _CRC_BYTES = (5, 7), 7, 2

Arrivals = list[tuple[int, bytes]]
"""What arrives instead of a packet: extra delay in ns, bytes."""


def _flip(frame: bytes, chance: random.Random, first: int, end: int) -> bytes:
    damaged = bytearray(frame)
    damaged[chance.randrange(first, end)] ^= 1 << chance.randrange(8)
    return bytes(damaged)


def _late(frame: bytes, value: float, chance: random.Random) -> Arrivals:
    return [(round(value * 1e9), frame)]


def _flipped(first: int, end: int) -> Callable[[bytes, float, random.Random], Arrivals]:
    def fault(frame: bytes, value: float, chance: random.Random) -> Arrivals:
        stop = end if end > 0 else len(frame) + end
        return [(0, _flip(frame, chance, first % len(frame), stop))]

    return fault


def _truncated(frame: bytes, value: float, chance: random.Random) -> Arrivals:
    return [(0, frame[: chance.randrange(1, len(frame))])]


def _noise(frame: bytes, value: float, chance: random.Random) -> Arrivals:
    return [(0, chance.randbytes(chance.randint(1, 8)) + frame)]


def _babble(frame: bytes, value: float, chance: random.Random) -> Arrivals:
    return [(0, chance.randbytes(round(value * 1e6)) + frame)]


def _foreign(frame: bytes, value: float, chance: random.Random) -> Arrivals:
    renamed = bytes((*frame[:4], _FOREIGN_ID, *frame[5:-_CRC_BYTES]))
    return [(0, renamed + codec.crc16(renamed).to_bytes(_CRC_BYTES, "little"))]


class OnReply(NamedTuple):
    """Fault of a reply on the line; `change` maps (frame, value, chance) to what arrives."""

    change: Callable[[bytes, float, random.Random], Arrivals]


class OnServo(NamedTuple):
    """Fault of a servo; `change` gets True when the fault begins, False when it ends."""

    change: Callable[[LoggedServo, float, bool], None]


class OnWrites(NamedTuple):
    """Fault in which the first writes to each servo are lost."""


class OnHost(NamedTuple):
    """Fault of the robot's software, which asks `hil.faults.host_faults.HostFaults` every tick."""

    what: str


FaultKind = OnReply | OnServo | OnWrites | OnHost

FAULT_KINDS: Final[dict[str, FaultKind]] = {
    "lost": OnReply(lambda frame, value, chance: []),
    "late": OnReply(_late),
    "duplicated": OnReply(lambda frame, value, chance: [(0, frame + frame)]),
    "flip in header": OnReply(_flipped(0, 3)),
    "flip in length": OnReply(_flipped(*_LENGTH_BYTES)),
    "flip in payload": OnReply(_flipped(_BODY_START, -_CRC_BYTES)),
    "flip in CRC": OnReply(_flipped(-_CRC_BYTES, 0)),
    "truncated": OnReply(_truncated),
    "noise": OnReply(_noise),
    "babble": OnReply(_babble),
    "other id": OnReply(_foreign),
    UNHEARD: OnWrites(),
    "silent": OnServo(lambda servo, value, on: servo.hush(on)),
    "hardware error": OnServo(lambda servo, value, on: servo.fail(int(value)) if on else None),
    "reboot": OnServo(lambda servo, value, on: servo.reboot() if on else None),
    "torque": OnServo(lambda servo, value, on: servo.lose_torque() if on else None),
    "watchdog": OnServo(lambda servo, value, on: servo.trip_watchdog() if on else None),
    "encoder": OnServo(lambda servo, value, on: setattr(servo, "angle_error_rad", value * on)),
    "frozen": OnServo(lambda servo, value, on: setattr(servo, "frozen", on)),
    "current": OnServo(lambda servo, value, on: setattr(servo, "current_error_a", value * on)),
    "predictor": OnHost("the predictor returns the value"),
    "estimator": OnHost("the estimator returns the value"),
    "slow predictor": OnHost("the predictor takes longer by the value in s"),
    "range": OnHost("the predictor says that it is out of range"),
    "innovation": OnHost("the feedback reads the value in A"),
    "stall": OnHost("the estimator takes longer by the value in s"),
    "garbage": OnHost("the estimator leaves reference cycles"),
    "clock": OnHost("the clock is ahead by the value in s"),
    "port": OnHost("the port is gone for the value in s"),
    "request": OnHost("a controlled stop is requested"),
    "flood": OnHost("bytes per second that arrive in place of replies"),
    "program silent": OnHost("the program that sends goals sends none"),
    "program stuck": OnHost("it repeats an old answer"),
    "program malformed": OnHost("it sends a message that cannot be read"),
    "program too fast": OnHost("it sends a step"),
    "program out of reach": OnHost("it sends a place that the tip cannot reach"),
    "program flooding": OnHost("it sends many messages"),
    "program gone": OnHost("it is gone"),
}
"""Every fault that can be injected, and how."""


@dataclass(frozen=True)
class Injection:
    """One fault of a plan."""

    kind: str
    # Number of exchanges in a row; ticks for a host fault, writes to each servo for `UNHEARD`
    times: int = 1
    # Delay in s, error in rad or A, hardware error bits, MB or bytes/s, depending on the kind
    value: float = 0.0
    joint: int | None = None  # Joint with the fault, from 0; None for all
    after: int = 0  # Exchanges from the start of the schedule to the start of this fault

    def __post_init__(self) -> None:
        if self.kind not in FAULT_KINDS:
            raise ValueError(f"no fault {self.kind!r}: choose from {', '.join(FAULT_KINDS)}")


class FaultSchedule(FaultPlan):
    """Seeded schedule of injections: faults of a `Line` and of the servos on a `LoggedBus`."""

    def __init__(self, injections: Sequence[Injection], seed: int) -> None:
        super().__init__(seed=seed)
        self._chance = random.Random(seed)
        self.start = self._chance.randrange(*FIRST_EXCHANGE)
        self.exchange = 0
        self.began_ns: int | None = None
        kinds = [(i, FAULT_KINDS[i.kind]) for i in injections]
        self._replies = [(i, k.change) for i, k in kinds if isinstance(k, OnReply)]
        self._servos = [(i, k.change) for i, k in kinds if isinstance(k, OnServo)]
        self._unheard_writes = [i for i, k in kinds if isinstance(k, OnWrites)]
        self._writes: Counter[int] = Counter()
        self._now_ns = 0

    def first(self, injection: Injection) -> int:
        """Return the exchange in which an injection begins."""
        return self.start + injection.after

    def active(self, injection: Injection, exchange: int) -> bool:
        """Return whether an injection is active in an exchange."""
        first = self.first(injection)
        return first <= exchange < first + injection.times

    def begin_exchange(self, servos: Sequence[LoggedServo], now_ns: int) -> None:
        """Count an exchange, and start and end the servo faults that are due in it."""
        self.exchange += 1
        self._now_ns = now_ns
        for injection, change in self._servos:
            first = self.first(injection)
            if self.exchange not in (first, first + injection.times):
                continue
            for joint, servo in enumerate(servos):
                if injection.joint in (None, joint):
                    change(servo, injection.value, self.exchange == first)
                    self._note_begin()

    def loses(self, packet: codec.Packet) -> bool:
        """Return whether an instruction is lost; only writes to a single servo can be."""
        due = [i for i in self._unheard_writes if self.exchange >= self.first(i)]
        if not due or packet.instruction != codec.Instruction.WRITE:
            return False
        self._writes[packet.id] += 1
        lost = self._writes[packet.id] <= max(i.times for i in due)
        if lost:
            self._note_begin()
        return lost

    def apply(self, frame: bytes) -> Arrivals:
        """Return what arrives instead of a status packet."""
        arrivals: Arrivals = [(0, frame)]
        for injection, change in self._replies:
            if self.active(injection, self.exchange):
                self._note_begin()
                arrivals = [
                    (delay_ns + more_ns, damaged)
                    for delay_ns, piece in arrivals
                    for more_ns, damaged in change(piece, injection.value, self._chance)
                ]
        return arrivals

    def _note_begin(self) -> None:
        if self.began_ns is None:
            self.began_ns = self._now_ns
