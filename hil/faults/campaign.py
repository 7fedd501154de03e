"""Fault campaign: every row of the fault table, on each of its lines, servo models and seeds."""

from __future__ import annotations

import contextlib
import signal
import socket
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Final

from firmware_py.core.console import Progress, Terminated, terminations_raised
from firmware_py.system.stop_signals import STOP_SIGNALS
from hil.faults.case_robot import CaseRobot
from hil.faults.fault_row import FaultRow
from hil.faults.fault_table import ROWS
from hil.faults.faults_document import CaseVerdict, FaultCase, judge_case
from hil.faults.observation import CaseObservation
from hil.faults.real_time_cases import run_process, run_socket
from hil.faults.virtual_case import run_virtual

RUNNERS: Final[dict[str, Callable[[CaseRobot, FaultRow, int, int], CaseObservation]]] = {
    "virtual": run_virtual,
    "socket": run_socket,
    "process": run_process,
}
"""Function that runs a case on each kind of line."""


def cases_of(
    dof: int, lines: Iterable[str], seeds: Sequence[int], rows: Iterable[FaultRow] = ROWS
) -> list[FaultCase]:
    """Return the cases in the order of the table, those on the virtual line first.

    The virtual line runs a row with every servo model and seed. In real time a row runs once, with
    its first model and the first seed.
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


def run_campaign(
    robot: CaseRobot,
    cases: Sequence[FaultCase],
    keep: Callable[[Sequence[CaseVerdict]], None] = lambda judged: None,
) -> list[CaseVerdict]:
    """Run and judge every case; `keep` receives all verdicts so far after each case."""
    progress = Progress("faults", len(cases))
    judged: list[CaseVerdict] = []
    with terminations_raised(), _signals_noted() as raise_noted:
        for case in cases:
            try:
                observed = RUNNERS[case.line](robot, case.row, case.number, case.seed)
            finally:  # a signal to the process group also ends the servos, and so fails the case
                raise_noted()
            judged.append(judge_case(case, observed, robot.bundle.manifest.period_s))
            keep(judged)
            progress.step(case.row.fault)
    return judged


@contextlib.contextmanager
def _signals_noted() -> Iterator[Callable[[], None]]:
    """Yield a function that raises if a stop signal has arrived since its last call.

    The loop of a case catches the signal and stops, as on the robot; the function lets the same
    signal end the campaign. Outside the main thread it does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: None
        return
    noted, notes = socket.socketpair()
    noted.setblocking(False)
    notes.setblocking(False)
    before = signal.set_wakeup_fd(notes.fileno(), warn_on_full_buffer=False)

    def raise_noted() -> None:
        numbers = b""
        with contextlib.suppress(BlockingIOError):
            numbers = noted.recv(4096)
        stops = set(numbers) & set(STOP_SIGNALS)
        if stops:
            raise KeyboardInterrupt if stops == {signal.SIGINT} else Terminated

    try:
        yield raise_noted
    finally:
        signal.set_wakeup_fd(before)
        noted.close()
        notes.close()
