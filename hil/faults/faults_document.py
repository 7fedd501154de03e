"""Verdict on each case of a campaign, and `faults.json`, which holds them.

A case passes if there is no complaint. A violation of safety always fails it. In real time the host
may preempt the loop or the servos' process. If the kernel's counters show that the loop lost slots
or data by preemption, or that a reply was delayed, a complaint about the course of the run proves
nothing, and the case is inconclusive.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Final

from firmware_py.bus.dynamixel import watchdog_steps
from firmware_py.bus.registers import WATCHDOG_STEP_S
from firmware_py.bus.servo_models import MODELS
from firmware_py.core.documents import Document, read_document
from firmware_py.core.units import TICK_TIME
from firmware_py.inference.manifest import Manifest
from firmware_py.safety.estimate_trust import FADE_S
from firmware_py.safety.states import UNRELEASED
from firmware_py.system.timing import Cause
from hil.faults.fault_row import FaultRow
from hil.faults.observation import CaseObservation
from hil.sil.processors import HostEnvironment, host_environment
from hil.verdict import JUnitCase, Verdict, junit_xml

_RESOLUTION_RAD: Final = 2e-3
"""Largest jump of a goal that rounding to pulses explains (1.5 mrad for an X servo)."""
_DRIFT_RAD: Final = 0.2
"""Largest movement to its last goal of a servo without a watchdog: the following-error limit."""


@dataclass(frozen=True)
class FaultCase:
    """One run of a row."""

    row: FaultRow
    line: str  # "virtual", "socket" or "process"
    number: int  # Model number of the servos
    seed: int  # Seed of the fault's time and bits

    @property
    def name(self) -> str:
        row = self.row
        return f"{row.fault}, {row.how} ({self.line}, {MODELS[self.number].name}, seed {self.seed})"


@dataclass(frozen=True)
class CaseVerdict:
    """A case, its observation and the complaints about it."""

    case: FaultCase
    observation: CaseObservation
    safety_violations: list[str]  # Violated conditions that hold in every case
    deviations: list[str]  # Differences from the outcome that the row expects

    @property
    def complaints(self) -> list[str]:
        return self.safety_violations + self.deviations

    @property
    def verdict(self) -> Verdict:
        if self.safety_violations:
            return Verdict.FAIL
        if not self.deviations:
            return Verdict.PASS
        run = self.observation
        preempted = run.misses.get(Cause.PREEMPTED.value, 0)
        disturbed = preempted or run.late_replies or run.held_up_replies or run.held_up_ticks
        if disturbed and self.case.line != "virtual":
            return Verdict.INCONCLUSIVE
        return Verdict.FAIL


def judge_case(case: FaultCase, run: CaseObservation, period_s: float) -> CaseVerdict:
    """Compare an observation with its row; `period_s` sets the timeout of the servos' watchdog."""
    return CaseVerdict(case, run, _safety_violations(run, period_s), _deviations(case.row, run))


def _safety_violations(run: CaseObservation, period_s: float) -> list[str]:
    """Violations of the conditions that hold in every case."""
    complaints = []
    limit_ns = round(watchdog_steps(period_s) * WATCHDOG_STEP_S * 1e9)
    if run.watched and run.unheard_ns > limit_ns:
        complaints.append(
            f"driven without supervision for {TICK_TIME.number(run.unheard_ns, 0)} ms, the "
            f"watchdog's time is {TICK_TIME.number(limit_ns, 0)} ms"
        )
    if run.live and (run.watched or run.ended == "finished"):
        complaints.append("a servo still drives in the end")
    elif run.live and run.ended in ("tripped", "signalled") and UNRELEASED not in run.reason:
        complaints.append("a servo still drives although the run says that it is released")
    if run.ended == "refused" and run.driven:
        complaints.append("the torque was on although it was refused")
    if run.live and run.drift_rad > _DRIFT_RAD:
        complaints.append(f"it moved {run.drift_rad:.3f} rad after the last that it heard")
    if run.fade_ticks is not None and run.fade_ticks > math.ceil(FADE_S / period_s):
        complaints.append(f"corrections faded for {run.fade_ticks} ticks")
    if run.goal_jump_rad > _RESOLUTION_RAD:
        complaints.append(f"a goal jumped by {run.goal_jump_rad:.4f} rad beyond the rate limit")
    # Replies carry no number: one that the host delivers a tick late answers the next read.
    if run.stale_as_fresh > run.late_replies:
        complaints.append(f"{run.stale_as_fresh} ticks took old data for fresh")
    return complaints


def _deviations(row: FaultRow, run: CaseObservation) -> list[str]:
    """Differences between the course of the run and the row's expectation."""
    must, complaints = row.must, []
    if row.injections and not run.injected:
        complaints.append("the fault did not occur")
    if must.unlogged and not run.unlogged_ticks:
        complaints.append("the log is whole: nothing was tried")
    if run.ended not in must.ended.split(" or "):
        complaints.append(f"{run.ended} ({run.reason}), not {must.ended}")
    elif must.reason and not any(words in run.reason for words in must.reason.split("|")):
        complaints.append(f"the reason is “{run.reason}”")
    if must.within is not None and not 0 < (run.detected_ticks or 0) <= must.within:
        complaints.append(f"seen in tick {run.detected_ticks}, not within {must.within}")
    if must.lost is not None and run.lost_ticks > must.lost:
        complaints.append(f"{run.lost_ticks} ticks lost, not {must.lost} at most")
    if must.trust and run.trust != must.trust:
        complaints.append(f"trust in the tip is {run.trust}, not {must.trust}")
    if must.on_time and run.misses:
        complaints.append(f"{sum(run.misses.values())} slots missed")
    if must.replugs != run.replugs:
        complaints.append(f"went on {run.replugs} times, not {must.replugs}")
    return complaints


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

    VERSION: ClassVar[int] = 3
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
    case, run = one.case, one.observation
    return CaseResult(
        **{name: getattr(run, name) for name in CaseObservation.__struct_fields__},
        fault=case.row.fault,
        how=case.row.how,
        line=case.line,
        model=MODELS[case.number].name,
        seed=case.seed,
        must=str(case.row.must),
        verdict=one.verdict,
        complaints=tuple(one.complaints),
    )


def read_faults(path: Path) -> FaultsDocument:
    return read_document(path, FaultsDocument)


def faults_junit(judged: Sequence[CaseVerdict], not_run: int = 0) -> bytes:
    """Return the verdicts as JUnit XML, one test case each.

    If planned cases were `not_run`, one more test case is reported as skipped.
    """
    cases = [
        JUnitCase(
            one.case.name, one.verdict, "; ".join(one.complaints), f"must: {one.case.row.must}"
        )
        for one in judged
    ]
    if not_run:
        words = f"incomplete: {not_run} cases were not run"
        must = "must: every case is run"
        cases.append(JUnitCase("all cases run", Verdict.INCONCLUSIVE, words, must))
    return junit_xml("faults", cases)
