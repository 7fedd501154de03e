"""Faults of the line: status packets lost, late or damaged, instructions lost.

`REPLY_FAULTS` has every kind of fault of a status packet, for the emulator and for the campaign
over all faults of the robot (`hil.faults`). The emulator draws faults at random: a rate is the
fraction of the servos' packets that have the fault; for "unheard", of the host's packets. A packet
has at most one fault, so the rates add up. The seed selects the faulty packets.
"""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable, Iterable
from typing import Final

from firmware_py.bus.codec import BODY, CRC_BYTES, Packet, crc16
from firmware_py.core.errors import InputError

UNHEARD: Final = "unheard"
"""Fault of an instruction: no servo receives it."""
LINE_FAULTS: Final = ("lost", "late", "duplicated", "corrupt", "truncated", "noise", UNHEARD)
"""Kinds that can be drawn at random (`dropstitch emulate --faults`)."""
LATE_S: Final = 0.012
"""Delay of a packet that is late at random: it misses the deadline of its exchange, but arrives
before the second exchange after that."""
_FOREIGN_ID: Final = 77

Arrivals = list[tuple[int, bytes]]
"""What arrives instead of a packet: extra delay in ns, bytes."""
ReplyFault = Callable[[bytes, float, random.Random], Arrivals]
"""Map from frame, size of the fault and source of chance to what arrives."""


def _late(frame: bytes, value: float, chance: random.Random) -> Arrivals:
    return [(round(value * 1e9), frame)]


def _flipped(first: int, end: int) -> ReplyFault:
    """Return the flip of one bit of `frame[first:end]`; an `end` of 0 is that of the frame."""

    def fault(frame: bytes, value: float, chance: random.Random) -> Arrivals:
        start, stop, _ = slice(first, end or None).indices(len(frame))
        damaged = bytearray(frame)
        damaged[chance.randrange(start, stop)] ^= 1 << chance.randrange(8)
        return [(0, bytes(damaged))]

    return fault


def _truncated(frame: bytes, value: float, chance: random.Random) -> Arrivals:
    return [(0, frame[: chance.randrange(1, len(frame))])]


def _noise(frame: bytes, value: float, chance: random.Random) -> Arrivals:
    return [(0, chance.randbytes(chance.randint(1, 8)) + frame)]


def _babble(frame: bytes, value: float, chance: random.Random) -> Arrivals:
    return [(0, chance.randbytes(round(value * 1e6)) + frame)]


def _foreign(frame: bytes, value: float, chance: random.Random) -> Arrivals:
    renamed = bytes((*frame[:4], _FOREIGN_ID, *frame[5:-CRC_BYTES]))
    return [(0, renamed + crc16(renamed).to_bytes(CRC_BYTES, "little"))]


REPLY_FAULTS: Final[dict[str, ReplyFault]] = {
    "lost": lambda frame, value, chance: [],
    "late": _late,  # by the value in s
    "duplicated": lambda frame, value, chance: [(0, frame + frame)],
    "corrupt": _flipped(0, 0),
    "flip in header": _flipped(0, 3),
    "flip in length": _flipped(5, BODY),
    "flip in payload": _flipped(BODY, -CRC_BYTES),
    "flip in CRC": _flipped(-CRC_BYTES, 0),
    "truncated": _truncated,
    "noise": _noise,
    "babble": _babble,  # the value in MB
    "other id": _foreign,
}
"""Every fault of a status packet."""


class FaultPlan:
    """Faults of the line, reproducible for equal seed and packets.

    `rates` gives the fraction of packets for each of `LINE_FAULTS`; others do not occur.
    """

    def __init__(self, rates: dict[str, float] | None = None, seed: int = 0) -> None:
        self.rates = dict(rates or {})
        self._unheard = self.rates.pop(UNHEARD, 0.0)
        self.injected: Counter[str] = Counter()
        self._random = random.Random(seed)

    def apply(self, frame: bytes) -> Arrivals:
        """Return what arrives instead of a status packet."""
        kind = self._draw()
        if kind is None:
            return [(0, frame)]
        self.injected[kind] += 1
        return REPLY_FAULTS[kind](frame, LATE_S, self._random)

    def loses(self, packet: Packet) -> bool:
        """Return whether the instruction is lost before it reaches any servo."""
        if self._unheard <= 0.0 or self._random.random() >= self._unheard:
            return False
        self.injected[UNHEARD] += 1
        return True

    def _draw(self) -> str | None:
        if not self.rates:
            return None
        point = self._random.random()
        for kind, rate in self.rates.items():
            if point < rate:
                return kind
            point -= rate
        return None


def parse_rates(words: Iterable[str]) -> dict[str, float]:
    """Parse arguments like `lost=0.01` into rates by kind of fault."""
    rates: dict[str, float] = {}
    for word in words:
        kind, _, text = word.partition("=")
        if kind not in LINE_FAULTS:
            raise InputError(f"--faults {word}", "is not known", f"use {', '.join(LINE_FAULTS)}")
        try:
            rates[kind] = float(text)
        except ValueError:
            raise InputError(
                f"--faults {word}", "has no rate", f"write it like {kind}=0.01"
            ) from None
        if not 0.0 <= rates[kind] <= 1.0:
            raise InputError(f"--faults {word}", "is not a fraction", "give a number from 0 to 1")
    if sum(rates.values()) > 1.0:
        raise InputError("--faults", "add up to more than one", "lower the rates")
    return rates
