"""Random faults of the line: status packets lost, late or damaged, instructions lost.

A rate is the fraction of the servos' packets that have the fault; for "unheard", of the host's
packets. A packet has at most one fault, so the rates add up. The seed selects the faulty packets.
The campaign over all faults of the robot is in `hil.faults`.
"""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Iterable
from typing import Final

from firmware_py.core.errors import InputError
from hil.emulator.packets import Packet

__all__ = ["LINE_FAULTS", "FaultPlan", "parse_rates"]

UNHEARD: Final = "unheard"
"""Fault of an instruction: no servo receives it."""
LINE_FAULTS: Final = ("lost", "late", "duplicated", "corrupt", "truncated", "noise", UNHEARD)
LATE_NS: Final = 12_000_000
"""Delay of a late packet: it misses the deadline of its exchange, but arrives before the second
exchange after that."""


class FaultPlan:
    """Faults of the line, reproducible for equal seed and packets.

    `rates` gives the fraction of packets for each kind of fault; other kinds do not occur.
    """

    def __init__(self, rates: dict[str, float] | None = None, seed: int = 0) -> None:
        self.rates = dict(rates or {})
        self._unheard = self.rates.pop(UNHEARD, 0.0)
        self.injected: Counter[str] = Counter()
        self._random = random.Random(seed)

    def apply(self, frame: bytes) -> list[tuple[int, bytes]]:
        """Return what arrives instead of `frame`: (extra delay in ns, bytes), or nothing."""
        kind = self._draw()
        if kind is None:
            return [(0, frame)]
        self.injected[kind] += 1
        chance = self._random
        if kind == "lost":
            return []
        if kind == "late":
            return [(LATE_NS, frame)]
        if kind == "duplicated":
            return [(0, frame + frame)]
        if kind == "truncated":
            return [(0, frame[: chance.randrange(1, len(frame))])]
        if kind == "noise":
            return [(0, chance.randbytes(chance.randint(1, 8)) + frame)]
        damaged = bytearray(frame)
        damaged[chance.randrange(len(damaged))] ^= 1 << chance.randrange(8)
        return [(0, bytes(damaged))]

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
