"""Messages between a campaign and its workers: the task of a case, and its outcome."""

from __future__ import annotations

import json
from typing import Any, Literal

import msgspec

State = Literal["done", "refused", "failed", "killed"]
"""End of a case: it has a result; its input cannot be used; its code failed; its worker died."""


class CaseTask(msgspec.Struct, frozen=True, kw_only=True):
    """One case as a worker gets it."""

    key: str  # Hash of the full configuration and of the code's version
    kind: str
    config: str  # Configuration as JSON, paths of files absolute
    files: dict[str, str]  # SHA-256 of every file or directory that the case reads, by its path
    code: str  # Version of the code that the campaign began with


class CaseCost(msgspec.Struct, frozen=True, kw_only=True):
    """Measured cost of a case; no part of its result."""

    wall_s: float  # Time by the clock and of the processor, without the start of the worker
    cpu_s: float
    memory_bytes: int  # Largest memory of the worker so far
    worker: str
    parts_s: dict[str, float] = {}  # Durations of parts that the kind measures


class TaskOutcome(msgspec.Struct, frozen=True, kw_only=True):
    """End of a case."""

    key: str
    state: State
    result: str = ""  # Result as canonical JSON; empty where there is none
    sentence: str = ""  # Why there is none
    log: str = ""  # Traceback and what the case printed, where there is no result
    cost: CaseCost | None = None  # None where the worker died


def canonical_json(value: Any) -> str:
    """JSON with sorted keys and without spaces; numbers that are not finite become null."""
    plain = msgspec.json.decode(msgspec.json.encode(value))  # msgspec writes NaN as null
    return json.dumps(plain, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
