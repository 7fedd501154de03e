"""Faults document (`faults.json`): every case of a fault campaign with its verdict."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

from firmware_py.bus.dynamixel import watchdog_steps
from firmware_py.bus.registers import WATCHDOG_STEP_S
from firmware_py.bus.servo_models import MODELS
from firmware_py.core.documents import Document, read_document, write_document
from firmware_py.inference.manifest import Manifest
from hil.faults.fault_verdict import CaseVerdict
from hil.faults.observation import CaseObservation
from hil.sil.processors import HostEnvironment, host_environment
from hil.verdict import Verdict

__all__ = ["CaseResult", "FaultsDocument", "faults_document", "read_faults", "write_faults"]


class CaseResult(CaseObservation, frozen=True, kw_only=True):
    """A case, its observation and its verdict."""

    fault: str  # Fault of the row in the fault table
    how: str  # How often or how long the fault is injected
    line: str  # Kind of line: "virtual", "socket" or "process"
    model: str  # Servo model
    seed: int  # Seed of the fault's time and bits
    must: str  # Expected outcome
    verdict: Verdict
    complaints: tuple[str, ...]  # Safety violations, then other differences from `must`


class FaultsDocument(Document, frozen=True, kw_only=True):
    """Contents of `faults.json`."""

    VERSION: ClassVar[int] = 2
    MADE_BY: ClassVar[str] = "dropstitch faults"

    # Worst verdict of the cases; inconclusive if cases were not run and none failed
    verdict: Verdict
    counts: dict[Verdict, int]  # Number of cases by verdict
    dof: int  # Number of joints
    period_s: float  # Control period
    watchdog_s: float  # Timeout of the servos' bus watchdog
    faults: int  # Number of faults
    rows: int  # Number of rows of the fault table: faults, and ways to inject them
    models: tuple[str, ...]  # Servo models of the cases
    seeds: tuple[int, ...]  # Seeds of the cases
    environment: HostEnvironment
    cases: tuple[CaseResult, ...]
    # Planned cases that were not run because the campaign was ended early; 0 if it is complete
    not_run: int = 0


def faults_document(
    manifest: Manifest, judged: Sequence[CaseVerdict], not_run: int = 0
) -> FaultsDocument:
    """Return the contents of `faults.json` after `judged` cases, with `not_run` still to come."""
    counts = {verdict: sum(one.verdict is verdict for one in judged) for verdict in Verdict}
    otherwise = Verdict.INCONCLUSIVE if not_run else Verdict.PASS
    worst = next((v for v in (Verdict.FAIL, Verdict.INCONCLUSIVE) if counts[v]), otherwise)
    cases = [one.case for one in judged]
    rows = {case.row for case in cases}
    return FaultsDocument(
        schema=FaultsDocument.VERSION,
        verdict=worst,
        counts=counts,
        dof=manifest.dof,
        period_s=manifest.period_s,
        watchdog_s=watchdog_steps(manifest.period_s) * WATCHDOG_STEP_S,
        faults=len({row.fault for row in rows}),
        rows=len(rows),
        models=tuple(MODELS[n].name for n in sorted({case.number for case in cases})),
        seeds=tuple(sorted({case.seed for case in cases})),
        environment=host_environment(),
        cases=tuple(_result(one) for one in judged),
        not_run=not_run,
    )


def _result(one: CaseVerdict) -> CaseResult:
    case, seen = one.case, one.observation
    return CaseResult(
        **{name: getattr(seen, name) for name in CaseObservation.__struct_fields__},
        fault=case.row.fault,
        how=case.row.how,
        line=case.line,
        model=MODELS[case.number].name,
        seed=case.seed,
        must=str(case.row.must),
        verdict=one.verdict,
        complaints=tuple(one.safety_violations + one.deviations),
    )


def read_faults(path: Path) -> FaultsDocument:
    return read_document(path, FaultsDocument)


def write_faults(path: Path, document: FaultsDocument) -> None:
    write_document(path, document)
