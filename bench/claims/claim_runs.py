"""Runs of the commands behind claims, and the values read from their results."""

from __future__ import annotations

import datetime
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Final

import msgspec

from bench.claims.claim_table import ROOT, Claim, ClaimFigure

DEFAULT_MINUTES: Final = 20.0
"""Claims whose command takes longer are measured only when they are named."""

Runner = Callable[[str], tuple[str, float]]
"""Command to its standard output and its duration in seconds."""


class Measurement(msgspec.Struct, frozen=True, kw_only=True):
    """Outcome of one claim."""

    claim: Claim
    figure: ClaimFigure | None = None  # The value, if there is one
    problem: str = ""  # Why there is no value; empty otherwise

    @property
    def met(self) -> bool | None:
        """Whether the target is met; False without a value, None without a target."""
        return self.claim.is_met(self.figure.value) if self.figure else False


def chosen_claims(claims: Iterable[Claim], patterns: Sequence[str]) -> list[Claim]:
    """Claims that patterns name, by name or group; without patterns those that are not long."""
    if not patterns:
        return [c for c in claims if c.minutes <= DEFAULT_MINUTES]
    return [
        c for c in claims
        if any(fnmatchcase(c.name, p) or fnmatchcase(c.group, p) for p in patterns)
    ]  # fmt: skip


def shell(command: str) -> tuple[str, float]:
    """Run a command in the checkout, its messages on stderr; returns output and seconds.

    The exit code is not judged: a command that misses its own limit still leaves its result.
    """
    print(f"$ {command}", file=sys.stderr, flush=True)
    path = f"{ROOT / '.venv' / 'bin'}{os.pathsep}{os.environ.get('PATH', '')}"
    keep = {k: v for k, v in os.environ.items() if k not in ("MAKEFLAGS", "MAKELEVEL")}
    start_s = time.monotonic()
    done = subprocess.run(
        command, shell=True, cwd=ROOT, env={**keep, "PATH": path}, stdout=subprocess.PIPE,
        text=True, check=False,
    )  # fmt: skip
    return done.stdout, time.monotonic() - start_s


def measure_claims(
    claims: Sequence[Claim], step: Callable[[str], None], run: Runner = shell, root: Path = ROOT
) -> list[Measurement]:
    """Measure claims in their order; claims with the same command share one run."""
    runs: dict[str, tuple[str, float]] = {}
    measured = []
    for claim in claims:
        if claim.command not in runs:
            runs[claim.command] = run(claim.command)
        output, seconds = runs[claim.command]
        measured.append(_measurement(claim, output, seconds, root))
        step(claim.name)
    return measured


def _measurement(claim: Claim, output: str, seconds: float, root: Path) -> Measurement:
    try:
        if claim.result == "time":
            data: Any = {"seconds": seconds}
        elif claim.result:
            data = json.loads((root / claim.result).read_text(encoding="utf-8"))
        else:
            data = json.loads(output)
        return Measurement(claim=claim, figure=figure_in(claim, data))
    except (OSError, ValueError, KeyError, IndexError, TypeError, ZeroDivisionError) as error:
        return Measurement(claim=claim, problem=f"{type(error).__name__}: {error}"[:200])


def figure_in(claim: Claim, data: Any) -> ClaimFigure:
    """ClaimFigure of a claim in the result of its command."""
    if (found := at_pointer(data, claim.value)) is None:
        raise ValueError(f"the result holds no figure at {claim.value}")
    value = float(found) * claim.factor
    if claim.over:
        value /= float(at_pointer(data, claim.over))
    interval = at_pointer(data, claim.interval) if claim.interval else ()
    return ClaimFigure(
        value=value,
        interval=tuple(claim.factor * float(x) for x in interval),
        of=int(at_pointer(data, claim.of)) if claim.of else None,
        on=datetime.date.today().isoformat(),
    )


def at_pointer(data: Any, pointer: str) -> Any:
    """Member of a JSON document that a JSON pointer (RFC 6901) names."""
    for part in pointer.split("/")[1:]:
        name = part.replace("~1", "/").replace("~0", "~")
        data = data[int(name)] if isinstance(data, list) else data[name]
    return data
