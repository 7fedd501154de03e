"""Kind of cases that only compute: a chain of hashes of a given length."""

from __future__ import annotations

import hashlib
import time
from typing import Any, ClassVar

from hil.campaign.kinds.case_kind import CaseConfig, CaseContext, CaseKind


class BusyConfig(CaseConfig, frozen=True, kw_only=True):
    """Configuration of a busy case."""

    rounds: int  # Hashes in the chain
    seed: int = 0


class BusyKind(CaseKind[BusyConfig]):
    """Busy cases."""

    name: ClassVar[str] = "busy"
    config: ClassVar[type[BusyConfig]] = BusyConfig
    rooms: ClassVar[tuple[str, ...]] = ("hil/campaign/kinds", "bench/campaigns")

    def run(self, config: BusyConfig, context: CaseContext) -> dict[str, Any]:
        """See `CaseKind.run`."""
        return {"digest": chain_of_hashes(config.rounds, config.seed)}


KIND = BusyKind()


def chain_of_hashes(rounds: int, seed: int) -> str:
    """Last digest of a chain."""
    digest = str(seed).encode()
    for _ in range(rounds):
        digest = hashlib.sha256(digest).digest()
    return digest.hex()


def rounds_for(cpu_s: float) -> int:
    """Length of a chain that takes so much processor time here."""
    start_s, probe = time.process_time(), 200_000
    chain_of_hashes(probe, 0)
    return round(probe * cpu_s / (time.process_time() - start_s))
