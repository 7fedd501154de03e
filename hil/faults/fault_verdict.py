"""The verdict: what happened held against what must happen; JSON and JUnit XML of it.

A case passes where no complaint is left. On a line in real time the host may take the processor
away: where the kernel's counters show that it cost slots, and nothing speaks against the safety of
the case, a complaint about its course proves nothing and the case is inconclusive.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from typing import Any, Final

from firmware_py.bus.dynamixel import watchdog_steps
from firmware_py.bus.registers import WATCHDOG_STEP_S
from firmware_py.bus.servo_models import MODELS
from firmware_py.console import DONE, INCONCLUSIVE, NEGATIVE
from firmware_py.realtime.timing import Cause
from hil.faults.fault_row import FaultRow
from hil.faults.observation import CaseObservation

RESOLUTION_RAD: Final = 2e-3
"""Goals are rounded to pulses (1.5 mrad with an X servo)."""
HELD_RAD: Final = 0.2
"""Without a watchdog a servo may still go to its last goal: the following error's limit."""


@dataclass(frozen=True)
class FaultCase:
    """One run of a row.

    Attributes
    ----------
    row : FaultRow
        What was tried.
    line : str
        "virtual", "socket" or "process".
    number : int
        Model number of the servos.
    seed : int
        Of the moment and of the bits.
    """

    row: FaultRow
    line: str
    number: int
    seed: int

    @property
    def name(self) -> str:
        """For people and for JUnit."""
        row = self.row
        return f"{row.fault}, {row.how} ({self.line}, {MODELS[self.number].name}, seed {self.seed})"


@dataclass(frozen=True)
class CaseVerdict:
    """A case with what happened and what is wrong with that.

    Attributes
    ----------
    case : FaultCase
        What was run.
    observation : CaseObservation
        What happened.
    unsafe, astray : list of str
        Complaints about safety; about the course, which must be as the row says.
    """

    case: FaultCase
    observation: CaseObservation
    unsafe: list[str]
    astray: list[str]

    @property
    def verdict(self) -> str:
        """One of "pass", "fail" and "inconclusive"."""
        if self.unsafe:
            return "fail"
        if not self.astray:
            return "pass"
        preempted = self.observation.misses.get(Cause.PREEMPTED.value, 0)
        return "inconclusive" if preempted and self.case.line != "virtual" else "fail"

    def as_dict(self) -> dict[str, Any]:
        """One entry of `faults.json`."""
        case = self.case
        return {
            "fault": case.row.fault, "how": case.row.how, "line": case.line,
            "model": MODELS[case.number].name, "seed": case.seed, "must": str(case.row.must),
            "verdict": self.verdict, "complaints": self.unsafe + self.astray,
            **self.observation.as_dict(),
        }  # fmt: skip


def judge_case(case: FaultCase, seen: CaseObservation, period_s: float) -> CaseVerdict:
    """Hold an observation against its row."""
    return CaseVerdict(case, seen, _unsafe(seen, period_s), _astray(case.row, seen))


def _unsafe(seen: CaseObservation, period_s: float) -> list[str]:
    """What must hold in every case."""
    complaints = []
    limit_ns = round(watchdog_steps(period_s) * WATCHDOG_STEP_S * 1e9)
    if seen.watched and seen.unheard_ns > limit_ns:
        complaints.append(
            f"driven without supervision for {seen.unheard_ns / 1e6:.0f} ms, the watchdog's time "
            f"is {limit_ns / 1e6:.0f} ms"
        )
    if seen.live and (seen.watched or seen.ended == "finished"):
        complaints.append("a servo still drives in the end")
    if seen.live and seen.drift_rad > HELD_RAD:
        complaints.append(f"it moved {seen.drift_rad:.3f} rad after the last that it heard")
    if seen.goal_jump_rad > RESOLUTION_RAD:
        complaints.append(f"a goal jumped by {seen.goal_jump_rad:.4f} rad beyond the rate limit")
    if seen.stale_as_fresh:
        complaints.append(f"{seen.stale_as_fresh} ticks took old data for fresh")
    return complaints


def _astray(row: FaultRow, seen: CaseObservation) -> list[str]:
    """Where the course differs from the row."""
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
    if must.replugs != seen.replugs:
        complaints.append(f"went on {seen.replugs} times, not {must.replugs}")
    return complaints


def report(judged: list[CaseVerdict], facts: dict[str, Any]) -> dict[str, Any]:
    """The contents of `faults.json`."""
    counts = {v: sum(j.verdict == v for j in judged) for v in ("pass", "fail", "inconclusive")}
    verdict = next((v for v in ("fail", "inconclusive") if counts[v]), "pass")
    return {
        "schema": 1, "verdict": verdict, "counts": counts, **facts,
        "cases": [j.as_dict() for j in judged],
    }  # fmt: skip


def exit_code(document: dict[str, Any]) -> int:
    """Exit code of a verdict."""
    return {"pass": DONE, "fail": NEGATIVE, "inconclusive": INCONCLUSIVE}[document["verdict"]]


def junit_xml(judged: list[CaseVerdict]) -> bytes:
    """The verdict as JUnit XML, one case each."""
    verdicts = [j.verdict for j in judged]
    suite = ET.Element(
        "testsuite", name="dropstitch.faults", tests=str(len(judged)),
        failures=str(verdicts.count("fail")), skipped=str(verdicts.count("inconclusive")),
    )  # fmt: skip
    for one, verdict in zip(judged, verdicts, strict=True):
        case = ET.SubElement(suite, "testcase", classname="faults", name=one.case.name)
        if verdict != "pass":
            kind = "failure" if verdict == "fail" else "skipped"
            words = "; ".join(one.unsafe + one.astray)
            ET.SubElement(case, kind, message=words).text = f"must: {one.case.row.must}"
    ET.indent(suite)
    document: bytes = ET.tostring(suite, encoding="utf-8", xml_declaration=True)
    return document
