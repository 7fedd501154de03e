"""Campaign of faults: every row of the table on every line, servo and seed that it names."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Final

from firmware_py.console import Progress
from hil.faults.cases.case_robot import CaseRobot
from hil.faults.cases.process_case import run_process
from hil.faults.cases.real_time_case import run_real_time
from hil.faults.cases.virtual_case import run_virtual
from hil.faults.fault_row import FaultRow
from hil.faults.fault_table import ROWS
from hil.faults.fault_verdict import CaseVerdict, FaultCase, judge_case
from hil.faults.observation import CaseObservation

RUNNERS: Final[dict[str, Callable[[CaseRobot, FaultRow, int, int], CaseObservation]]] = {
    "virtual": run_virtual,
    "socket": run_real_time,
    "process": run_process,
}
"""Function that runs a case, by its line."""


def cases_of(
    dof: int, lines: Iterable[str], seeds: Sequence[int], rows: Iterable[FaultRow] = ROWS
) -> list[FaultCase]:
    """Return the cases in the order of the table, the virtual line first.

    In real time a row runs once, on its first model; the virtual line varies the bits.

    Parameters
    ----------
    dof : int
        Joints of the robot.
    lines : iterable of str
        Lines to run on, keys of `RUNNERS`.
    seeds : sequence of int
        Seeds, of which only the first is used in real time.
    rows : iterable of FaultRow
        Rows to run.
    """
    cases = []
    for line in RUNNERS:
        if line not in lines:
            continue
        for row in rows:
            if line not in row.lines or row.joints > dof:
                continue
            many = line == "virtual"
            for number in row.models if many else row.models[:1]:
                cases += [FaultCase(row, line, number, s) for s in (seeds if many else seeds[:1])]
    return cases


def run_campaign(robot: CaseRobot, cases: Sequence[FaultCase]) -> list[CaseVerdict]:
    """Run and judge every case.

    Parameters
    ----------
    robot : CaseRobot
        Common part of the campaign.
    cases : sequence of FaultCase
        Cases, in order.
    """
    progress = Progress("faults", len(cases))
    judged = []
    for case in cases:
        seen = RUNNERS[case.line](robot, case.row, case.number, case.seed)
        judged.append(judge_case(case, seen, robot.bundle.manifest.period_s))
        progress.step(case.row.fault)
    return judged
