"""Engine of processes on this machine.

Each worker has its own pipe and one case at a time. So when a worker dies, exactly one case can
have caused it. `concurrent.futures` would end all cases with the first dead worker.
"""

from __future__ import annotations

import contextlib
import faulthandler
import multiprocessing
import os
import signal
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Final

from hil.campaign.case_task import CaseTask, TaskOutcome
from hil.campaign.case_worker import MOST_LOG, run_task
from hil.campaign.engines.engine import ATTEMPTS, killed_outcome
from models.shared.worker_pool import end_with_parent

_SPAWN: Final = multiprocessing.get_context("spawn")
_END_S: Final = 5.0
"""Timeout for a worker to end by itself."""


def serve_tasks(pipe: Connection, log: str) -> None:
    """Run the tasks that arrive through a pipe until it closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a Ctrl-C in the terminal ends the campaign
    end_with_parent()  # a closed pipe ends only a worker that waits for a task
    descriptor = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    for stream in (1, 2):
        os.dup2(descriptor, stream)
    faulthandler.enable()
    with contextlib.suppress(EOFError, BrokenPipeError, ConnectionResetError):
        while (task := pipe.recv()) is not None:
            pipe.send(run_task(task))


@dataclass
class _Worker:
    """Worker process with the number of its task."""

    process: multiprocessing.process.BaseProcess
    pipe: Connection
    log: Path
    task: int | None = None
    log_start: int = 0

    def give(self, number: int, task: CaseTask) -> None:
        self.task = number
        self.log_start = self.log.stat().st_size if self.log.exists() else 0
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # handled on receiving
            self.pipe.send(task)

    def written(self) -> str:
        if not self.log.exists():
            return ""
        with self.log.open("rb") as file:
            file.seek(self.log_start)
            return file.read().decode(errors="replace")[-MOST_LOG:]


class ProcessEngine:
    """Engine that runs cases in processes of this machine."""

    shared = False

    def __init__(self, workers: int, directory: Path) -> None:
        self._count, self._directory = workers, directory
        self._workers: list[_Worker] = []

    def outcomes(self, tasks: Sequence[CaseTask]) -> Iterator[TaskOutcome]:
        self._directory.mkdir(parents=True, exist_ok=True)
        left, attempts = deque(range(len(tasks))), Counter[int]()
        try:
            for number in range(min(self._count, len(tasks))):
                self._workers.append(self._start(number))
            while left or any(w.task is not None for w in self._workers):
                for worker in self._workers:
                    if worker.task is None and left:
                        number = left.popleft()
                        worker.give(number, tasks[number])
                busy = {w.pipe: w for w in self._workers if w.task is not None}
                for pipe in wait(list(busy)):
                    yield from self._received(busy[pipe], tasks, left, attempts)  # type: ignore[index]
        finally:
            self._stop()

    def _received(
        self, worker: _Worker, tasks: Sequence[CaseTask], left: deque[int], attempts: Counter[int]
    ) -> Iterator[TaskOutcome]:
        number = worker.task
        if number is None:
            return
        try:
            outcome: TaskOutcome = worker.pipe.recv()
        except (EOFError, ConnectionResetError):
            worker.process.join()
            how, log = _end_of(worker.process.exitcode), worker.written()
            worker.pipe.close()
            self._workers[self._workers.index(worker)] = self._start(self._workers.index(worker))
            attempts[number] += 1
            if attempts[number] < ATTEMPTS:
                left.append(number)
            else:
                yield killed_outcome(tasks[number].key, how, log)
            return
        worker.task = None
        yield outcome

    def _start(self, number: int) -> _Worker:
        own, other = _SPAWN.Pipe()
        log = self._directory / f"worker-{number}.log"
        process = _SPAWN.Process(target=serve_tasks, args=(other, str(log)))
        process.start()
        other.close()
        return _Worker(process, own, log)

    def _stop(self) -> None:
        """End the workers: idle ones by a message, busy ones by a signal."""
        for worker in self._workers:
            if worker.task is not None:
                worker.process.terminate()
            else:
                with contextlib.suppress(OSError):
                    worker.pipe.send(None)
        for worker in self._workers:
            worker.process.join(_END_S)
            if worker.process.is_alive():
                worker.process.kill()
                worker.process.join()
            worker.pipe.close()
        self._workers = []


def _end_of(code: int | None) -> str:
    if code is not None and code < 0:
        return f"the worker was ended by {signal.Signals(-code).name}"
    return f"the worker ended with code {code}"
