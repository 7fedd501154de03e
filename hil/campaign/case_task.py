"""Messages between a campaign and its workers: the task of a case, and its outcome."""

from __future__ import annotations

import json
from typing import Any, Literal

import msgspec

State = Literal["done", "refused", "failed", "killed"]
"""Outcome of a case: it has a result, its input cannot be used, its code failed, or its workers
died."""


class CaseTask(msgspec.Struct, frozen=True, kw_only=True):
    """One case as sent to a worker."""

    key: str  # Hash of the full configuration and the version of the code
    kind: str  # Module of the kind
    config: str  # Configuration as JSON, with absolute paths
    files: dict[str, str]  # SHA-256 of every file or directory that the case reads, by path
    code: str  # Version of the code at the start of the campaign


class CaseCost(msgspec.Struct, frozen=True, kw_only=True):
    """Measured cost of a case, which is not part of its result."""

    wall_s: float  # Wall-clock time without the start of the worker
    cpu_s: float  # Processor time without the start of the worker
    memory_bytes: int  # Peak memory of the worker so far
    worker: str  # Host and process of the worker
    parts_s: dict[str, float] = {}  # Durations that the kind measures


class TaskOutcome(msgspec.Struct, frozen=True, kw_only=True):
    """Outcome of a case."""

    key: str
    state: State
    result: str = ""  # Result as canonical JSON; empty if there is none
    sentence: str = ""  # Why there is no result
    log: str = ""  # Output and traceback of a case without a result
    cost: CaseCost | None = None  # None if the worker died


def canonical_json(value: Any) -> str:
    """Encode as JSON with sorted keys and without spaces; NaN and infinity become null."""
    plain = msgspec.json.decode(msgspec.json.encode(value))  # msgspec writes NaN as null
    return json.dumps(plain, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
