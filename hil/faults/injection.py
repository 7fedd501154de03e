"""Injection of faults of line and servo: the plan says which and how often, the seed when.

An exchange is one synchronous read of the loop, counted from the moment that the torque is on.
"""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

from hil.emulator import packets
from hil.emulator.line_faults import UNHEARD, FaultPlan
from hil.faults.servo_log import LoggedServo

FOREVER: Final = 1_000_000
FIRST_EXCHANGE: Final = (40, 110)
"""Range from which the seed draws the first exchange with a fault: the arm moves then."""

_FOREIGN_ID: Final = 77
_LENGTH_BYTES, _BODY_START, _CRC_BYTES = (5, 7), 7, 2

Arrivals = list[tuple[int, bytes]]
"""What arrives in place of a packet: extra delay in ns, bytes."""


class Injection(NamedTuple):
    """One fault of a plan.

    Attributes
    ----------
    kind : str
        Key of `LINE_FAULTS` or `SERVO_FAULTS`, `UNHEARD`, or a fault of the host
        (`hil.faults.host_faults`).
    times : int
        Exchanges in a row; of `UNHEARD`, writes to each servo that it does not hear.
    value : float
        Delay in s, error in rad or A, hardware error bits, MB or bytes/s, by the kind.
    joint : int or None
        Joint with the fault, from 0; None for all.
    after : int
        Exchanges between the first of the plan and the first of this one.
    """

    kind: str
    times: int = 1
    value: float = 0.0
    joint: int | None = None
    after: int = 0


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
    return [(0, renamed + packets.crc16(renamed).to_bytes(_CRC_BYTES, "little"))]


LINE_FAULTS: Final[dict[str, Callable[[bytes, float, random.Random], Arrivals]]] = {
    "lost": lambda frame, value, chance: [],
    "late": _late,
    "duplicated": lambda frame, value, chance: [(0, frame + frame)],
    "flip in header": _flipped(0, 3),
    "flip in length": _flipped(*_LENGTH_BYTES),
    "flip in payload": _flipped(_BODY_START, -_CRC_BYTES),
    "flip in CRC": _flipped(-_CRC_BYTES, 0),
    "truncated": _truncated,
    "noise": _noise,
    "babble": _babble,
    "other id": _foreign,
}
"""Faults of the line: functions from (frame, value, chance) to what arrives in its place."""

SERVO_FAULTS: Final[dict[str, Callable[[LoggedServo, float, bool], None]]] = {
    "silent": lambda servo, value, on: servo.hush(on),
    "hardware error": lambda servo, value, on: servo.fail(int(value)) if on else None,
    "reboot": lambda servo, value, on: servo.reboot() if on else None,
    "torque": lambda servo, value, on: servo.lose_torque() if on else None,
    "watchdog": lambda servo, value, on: servo.trip_watchdog() if on else None,
    "encoder": lambda servo, value, on: setattr(servo, "angle_error_rad", value * on),
    "current": lambda servo, value, on: setattr(servo, "current_error_a", value * on),
}
"""Faults of a servo: functions called with True as the fault begins, with False as it ends."""


class FaultSchedule(FaultPlan):
    """Seeded schedule of injections: faults of a `Line` and of the servos on a `LoggedBus`.

    Parameters
    ----------
    injections : sequence of Injection
        The plan.
    seed : int
        Of its time and of its bits.

    Attributes
    ----------
    start : int
        Exchange in which the plan begins.
    exchange : int
        Number of the exchange that runs, 0 before the first.
    began_ns : int or None
        When the first fault began.
    """

    def __init__(self, injections: Sequence[Injection], seed: int) -> None:
        super().__init__(seed=seed)
        self._chance = random.Random(seed)
        self.start = self._chance.randrange(*FIRST_EXCHANGE)
        self.exchange = 0
        self.began_ns: int | None = None
        self._injections = tuple(injections)
        self._line = [i for i in injections if i.kind in LINE_FAULTS]
        self._unheard_writes = [i for i in injections if i.kind == UNHEARD]
        self._writes: Counter[int] = Counter()

    def first(self, injection: Injection) -> int:
        """Exchange in which an injection begins."""
        return self.start + injection.after

    def active(self, injection: Injection, exchange: int) -> bool:
        """Whether an injection is active in an exchange.

        Parameters
        ----------
        injection : Injection
            One of the plan.
        exchange : int
            Number of the exchange.
        """
        first = self.first(injection)
        return first <= exchange < first + injection.times

    def begin_exchange(self, servos: Sequence[LoggedServo], now_ns: int) -> None:
        """Begin and end the servo faults of the next exchange.

        Parameters
        ----------
        servos : sequence of LoggedServo
            Servos in joint order.
        now_ns : int
            Time of the exchange.
        """
        self.exchange += 1
        if self.began_ns is None and any(self.active(i, self.exchange) for i in self._injections):
            self.began_ns = now_ns
        for injection in self._injections:
            change = SERVO_FAULTS.get(injection.kind)
            first = self.first(injection)
            if change is None or self.exchange not in (first, first + injection.times):
                continue
            for joint, servo in enumerate(servos):
                if injection.joint in (None, joint):
                    change(servo, injection.value, self.exchange == first)

    def loses(self, packet: packets.Packet) -> bool:
        """Return whether no servo receives an instruction; only writes to one servo are lost."""
        due = [i for i in self._unheard_writes if self.exchange >= self.first(i)]
        if not due or packet.instruction != packets.Instruction.WRITE:
            return False
        self._writes[packet.id] += 1
        return self._writes[packet.id] <= max(i.times for i in due)

    def apply(self, frame: bytes) -> Arrivals:
        """Return what arrives in place of a status packet."""
        arrivals: Arrivals = [(0, frame)]
        for injection in self._line:
            if self.active(injection, self.exchange):
                fault = LINE_FAULTS[injection.kind]
                arrivals = [
                    (delay_ns + more_ns, damaged)
                    for delay_ns, piece in arrivals
                    for more_ns, damaged in fault(piece, injection.value, self._chance)
                ]
        return arrivals
