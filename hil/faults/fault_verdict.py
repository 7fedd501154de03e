"""Verdict on a case of the campaign: its observation compared with its row of the table.

A case passes if there is no complaint. A violation of safety always fails it. In real time the host
may preempt the loop or the servos' process. If the kernel's counters show that the loop lost slots
or data by preemption, or that a reply was delayed, a complaint about the course of the run proves
nothing, and the case is inconclusive.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from firmware_py.bus.dynamixel import watchdog_steps
from firmware_py.bus.registers import WATCHDOG_STEP_S
from firmware_py.bus.servo_models import MODELS
from firmware_py.core.units import TICK_TIME
from firmware_py.safety.estimate_trust import FADE_S
from firmware_py.safety.states import UNRELEASED
from firmware_py.system.timing import Cause
from hil.faults.fault_row import FaultRow
from hil.faults.observation import TOLD_NOTHING, CaseObservation
from hil.verdict import JUnitCase, Verdict, junit_xml

RESOLUTION_RAD: Final = 2e-3
"""Largest jump of a goal that rounding to pulses explains (1.5 mrad for an X servo)."""
HELD_RAD: Final = 0.2
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
        """Name for reports."""
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
    def verdict(self) -> Verdict:
        if self.safety_violations:
            return Verdict.FAIL
        if not self.deviations:
            return Verdict.PASS
        seen = self.observation
        preempted = seen.misses.get(Cause.PREEMPTED.value, 0)
        held_up = preempted or seen.late_replies or seen.held_up_replies or seen.held_up_ticks
        if held_up and self.case.line != "virtual":
            return Verdict.INCONCLUSIVE
        return Verdict.FAIL


def judge_case(case: FaultCase, seen: CaseObservation, period_s: float) -> CaseVerdict:
    """Compare an observation with its row; `period_s` sets the timeout of the servos' watchdog."""
    return CaseVerdict(case, seen, _safety_violations(seen, period_s), _deviations(case.row, seen))


def _safety_violations(seen: CaseObservation, period_s: float) -> list[str]:
    """Violations of the conditions that hold in every case."""
    complaints = []
    limit_ns = round(watchdog_steps(period_s) * WATCHDOG_STEP_S * 1e9)
    if seen.watched and seen.unheard_ns > limit_ns:
        complaints.append(
            f"driven without supervision for {TICK_TIME.number(seen.unheard_ns, 0)} ms, the "
            f"watchdog's time is {TICK_TIME.number(limit_ns, 0)} ms"
        )
    if seen.live and (seen.watched or seen.ended == "finished"):
        complaints.append("a servo still drives in the end")
    elif seen.live and seen.ended in ("tripped", "signalled") and UNRELEASED not in seen.reason:
        complaints.append("a servo still drives although the run says that it is released")
    if seen.ended == "refused" and seen.told != TOLD_NOTHING:
        complaints.append(f"the torque was on although it was refused: {seen.told}")
    if seen.live and seen.drift_rad > HELD_RAD:
        complaints.append(f"it moved {seen.drift_rad:.3f} rad after the last that it heard")
    if seen.fade_ticks is not None and seen.fade_ticks > math.ceil(FADE_S / period_s):
        complaints.append(f"corrections faded for {seen.fade_ticks} ticks")
    if seen.goal_jump_rad > RESOLUTION_RAD:
        complaints.append(f"a goal jumped by {seen.goal_jump_rad:.4f} rad beyond the rate limit")
    # Replies carry no number: one that the host delivers a tick late answers the next read.
    if seen.stale_as_fresh > seen.late_replies:
        complaints.append(f"{seen.stale_as_fresh} ticks took old data for fresh")
    return complaints


def _deviations(row: FaultRow, seen: CaseObservation) -> list[str]:
    """Differences between the course of the run and the row's expectation."""
    must, complaints = row.must, []
    if row.injections and not seen.injected:
        complaints.append("the fault never befell it")
    if must.unlogged and not seen.unlogged_ticks:
        complaints.append("the log is whole: nothing was tried")
    if seen.ended not in must.ended.split(" or "):
        complaints.append(f"{seen.ended} ({seen.reason}), not {must.ended}")
    elif must.reason and not any(words in seen.reason for words in must.reason.split("|")):
        complaints.append(f"the reason is “{seen.reason}”")
    if must.within is not None and not 0 < (seen.detected_ticks or 0) <= must.within:
        complaints.append(f"seen in tick {seen.detected_ticks}, not within {must.within}")
    if must.lost is not None and seen.lost_ticks > must.lost:
        complaints.append(f"{seen.lost_ticks} ticks lost, not {must.lost} at most")
    if must.trust and seen.trust != must.trust:
        complaints.append(f"trust in the tip is {seen.trust}, not {must.trust}")
    if must.on_time and seen.misses:
        complaints.append(f"{sum(seen.misses.values())} slots missed")
    if must.replugs != seen.replugs:
        complaints.append(f"went on {seen.replugs} times, not {must.replugs}")
    return complaints


def faults_junit(judged: Sequence[CaseVerdict], not_run: int = 0) -> bytes:
    """Return the verdicts as JUnit XML, one test case each.

    If planned cases were `not_run`, one more test case is reported as skipped.
    """
    words = f"incomplete: {not_run} cases were not run"
    missing = [JUnitCase("all cases run", Verdict.INCONCLUSIVE, words, "must: every case is run")]
    return junit_xml(
        "faults",
        [
            JUnitCase(
                one.case.name,
                one.verdict,
                "; ".join(one.safety_violations + one.deviations),
                f"must: {one.case.row.must}",
            )
            for one in judged
        ]
        + (missing if not_run else []),
    )
