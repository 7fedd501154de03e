"""Engine of submitit: jobs of a cluster's queue (SLURM), or processes of this machine to try it.

A job runs several cases, one after the other, and leaves each outcome in a file at once, so that a
job that is killed loses the case in flight alone. The directory of the campaign must be on a file
system that all nodes see.
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

from firmware_py.errors import InputError
from hil.campaign.case_task import CaseTask, TaskOutcome
from hil.campaign.case_worker import MOST_LOG, run_task
from hil.campaign.code_version import ROOT
from hil.campaign.engines.engine import ATTEMPTS, killed_outcome

LOOK_S: Final = 0.5
"""Time between two looks at the jobs [assumed]."""
MOST_IN_JOB: Final = 500
"""Cases of the largest job: at most so many wait behind one that ends badly [assumed]."""
JOBS_PER_WORKER: Final = 4
"""Jobs that each worker gets in turn, so that all end at about the same time [assumed]."""


def run_batch(tasks: list[CaseTask], directory: str) -> int:
    """Run tasks in a job, leave each outcome in a file; return their number."""
    for task in tasks:
        path = Path(directory) / f"{task.key}.json"
        fresh = path.with_suffix(".part")
        fresh.write_bytes(msgspec.json.encode(run_task(task)))
        fresh.replace(path)
    return len(tasks)


class SubmititEngine:
    """Engine of submitit.

    `cluster`: "slurm", "local" for processes of this machine; None for what submitit finds.
    """

    shared = True

    def __init__(
        self, workers: int, directory: Path, cluster: str | None, parameters: Mapping[str, str]
    ) -> None:
        try:
            import submitit  # an extra: imported where it is asked for
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
        except Exception as error:  # of several types, by cluster
            raise InputError(
                "--executor submitit", f"cannot be set up ({error})",
                "give another --cluster or --parameter",
            ) from None  # fmt: skip

    def outcomes(self, tasks: Sequence[CaseTask]) -> Iterator[TaskOutcome]:
        """See `Engine.outcomes`."""
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
                    if numbers:  # the first of them was in flight
                        attempts[numbers[0]] += 1
                        if attempts[numbers[0]] >= ATTEMPTS:
                            yield killed_outcome(tasks[numbers.pop(0)].key, *_end_of_job(job))
                        left.extend(numbers)
        finally:
            for job in running:
                with contextlib.suppress(Exception):  # it may end by itself meanwhile
                    job.cancel()

    def _submit(self, tasks: list[CaseTask]) -> Any:
        try:
            return self._executor.submit(run_batch, tasks, str(self._spool.resolve()))
        except Exception as error:  # sbatch refuses in many ways
            raise InputError(
                "--executor submitit", f"cannot submit a job ({error})", "give another --parameter"
            ) from None

    def _left(self, key: str) -> TaskOutcome | None:
        """Outcome that a job has left; its file is removed."""
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
    """How a job ended, and the end of what it wrote."""
    with contextlib.suppress(Exception):  # its files may be missing
        return f"job {job.job_id}: {job.state}", (job.stderr() or "")[-MOST_LOG:]
    return f"job {job.job_id}", ""
