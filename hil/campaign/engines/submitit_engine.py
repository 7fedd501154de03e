"""Engine of submitit: jobs in a cluster's queue (SLURM), or local processes to try it out.

A job runs several cases one after the other and writes each outcome to a file at once, so a job
that is killed loses only the running case. The directory of the campaign must be on a file system
that all nodes share.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec

from firmware_py.core.errors import InputError
from hil.campaign.case_task import CaseTask, TaskOutcome
from hil.campaign.case_worker import MOST_LOG, run_task
from hil.campaign.code_version import ROOT
from hil.campaign.engines.engine import ATTEMPTS, killed_outcome

LOOK_S: Final = 0.5
"""Period of checks of the jobs [assumed]."""
MOST_IN_JOB: Final = 500
"""Largest number of cases in a job, which limits how many wait behind one that kills it
[assumed]."""
JOBS_PER_WORKER: Final = 4
"""Number of jobs for each worker, so that all workers end at about the same time [assumed]."""


def run_batch(tasks: list[CaseTask], directory: str) -> int:
    """Run tasks in a job, write each outcome to a file, and return the number of tasks."""
    for task in tasks:
        path = Path(directory) / f"{task.key}.json"
        fresh = path.with_suffix(".part")
        fresh.write_bytes(msgspec.json.encode(run_task(task)))
        fresh.replace(path)
    return len(tasks)


class SubmititEngine:
    """Engine that runs cases in jobs of submitit.

    `cluster` is "slurm", "local" for processes of this machine, or None for automatic detection.
    """

    shared = True

    def __init__(
        self, workers: int, directory: Path, cluster: str | None, parameters: Mapping[str, str]
    ) -> None:
        try:
            import submitit  # an optional dependency
        except ImportError:
            raise InputError(
                "--executor submitit", "needs an extra that is not installed",
                "run: python -m pip install 'dropstitch[submitit]'",
            ) from None  # fmt: skip
        self._count, self._directory = workers, directory
        self._spool = directory / "outcomes"
        self._spool.mkdir(parents=True, exist_ok=True)
        paths = [str(ROOT), os.environ.get("PYTHONPATH", "")]
        os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, paths))
        try:
            self._executor: Any = submitit.AutoExecutor(directory / "jobs", cluster=cluster)
            self._executor.update_parameters(
                name="dropstitch", **{n: _number(v) for n, v in parameters.items()}
            )
        except Exception as error:  # the type depends on the cluster
            raise InputError(
                "--executor submitit", f"cannot be set up ({error})",
                "give another --cluster or --parameter",
            ) from None  # fmt: skip

    def outcomes(self, tasks: Sequence[CaseTask]) -> Iterator[TaskOutcome]:
        size = -(-len(tasks) // (JOBS_PER_WORKER * self._count))
        size = min(max(size, 1), MOST_IN_JOB)
        left, attempts = deque(range(len(tasks))), Counter[int]()
        running: dict[Any, list[int]] = {}
        try:
            while left or running:
                while left and len(running) < self._count:
                    numbers = [left.popleft() for _ in range(min(size, len(left)))]
                    running[self._submit([tasks[n] for n in numbers])] = numbers
                time.sleep(LOOK_S)
                for job, numbers in list(running.items()):
                    ended = job.done(force_check=True)
                    while numbers and (outcome := self._left(tasks[numbers[0]].key)):
                        del numbers[0]
                        yield outcome
                    if not ended:
                        continue
                    del running[job]
                    if numbers:  # the first of them was running
                        attempts[numbers[0]] += 1
                        if attempts[numbers[0]] >= ATTEMPTS:
                            yield killed_outcome(tasks[numbers.pop(0)].key, *_end_of_job(job))
                        left.extend(numbers)
        finally:
            for job in running:
                with contextlib.suppress(Exception):  # the job may have ended meanwhile
                    job.cancel()

    def _submit(self, tasks: list[CaseTask]) -> Any:
        try:
            return self._executor.submit(run_batch, tasks, str(self._spool.resolve()))
        except Exception as error:  # sbatch refuses in many ways
            raise InputError(
                "--executor submitit", f"cannot submit a job ({error})", "give another --parameter"
            ) from None

    def _left(self, key: str) -> TaskOutcome | None:
        """Take the outcome that a job has written, and remove its file; None if there is none."""
        path = self._spool / f"{key}.json"
        try:
            outcome = msgspec.json.decode(path.read_bytes(), type=TaskOutcome)
        except (OSError, ValueError):
            return None
        path.unlink()
        return outcome


def _number(text: str) -> int | str:
    return int(text) if text.isdecimal() else text


def _end_of_job(job: Any) -> tuple[str, str]:
    """Describe the end of a job, with the last part of its standard error."""
    with contextlib.suppress(Exception):  # its files may be missing
        return f"job {job.job_id}: {job.state}", (job.stderr() or "")[-MOST_LOG:]
    return f"job {job.job_id}", ""
