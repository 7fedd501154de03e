"""Engine of a dask cluster.

How distributed 2026.8 handles a dead worker (`Scheduler.remove_worker`): the suspicion count of
every task that was assigned to it, running or not, rises by one, and the task runs elsewhere. A
task whose count exceeds `distributed.scheduler.allowed-failures` (3) ends in `KilledWorker`. So a
harmless case can end this way because it was queued behind one that kills its worker. Such a case
is therefore run once more at the end, alone, and counts as killed only if it fails again. Results
stay on workers until they are gathered; those of a dead worker are computed again. A `Nanny`
restarts a dead worker, but not one that died during its start.
"""

from __future__ import annotations

import contextlib
import itertools
import logging
import math
import queue
import sys
import time
import uuid
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any, Final

from firmware_py.core.errors import InputError
from hil.campaign.case_task import CaseTask, TaskOutcome
from hil.campaign.case_worker import run_task
from hil.campaign.engines.engine import killed_outcome

CONNECT_S: Final = 10.0
"""Timeout of the scheduler's answer [assumed]."""
AHEAD: Final = 4
"""Cases sent ahead for each worker, so that no worker idles: a case of 0.5 s and a round trip of
some ms need two [assumed]."""
LOOK_S: Final = 5.0
"""Period of checks of the cluster while no case ends [assumed]."""
EMPTY_S: Final = 300.0
"""Timeout of a cluster without workers; a queue may still have to start new ones [assumed]."""
LOST_MOST: Final = 10
"""Largest number of retries of a case that the cluster loses without a reason [assumed]."""


class DaskEngine:
    """Engine that runs cases on a dask cluster."""

    shared = True

    def __init__(self, scheduler: str) -> None:
        try:
            import distributed  # an optional dependency
        except ImportError:
            raise InputError(
                "--executor dask", "needs an extra that is not installed",
                "run: python -m pip install 'dropstitch[dask]'",
            ) from None  # fmt: skip
        self._dask: Any = distributed
        self._scheduler = scheduler

    def outcomes(self, tasks: Sequence[CaseTask]) -> Iterator[TaskOutcome]:
        client = self._connect()
        try:
            yield from _DaskRun(self._dask, client, self._scheduler, tasks).outcomes()
        finally:
            with contextlib.suppress(Exception):  # the cluster may no longer answer
                client.close(timeout=CONNECT_S)

    def _connect(self) -> Any:
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        try:
            client = self._dask.Client(
                self._scheduler, timeout=CONNECT_S, set_as_default=False, name="dropstitch"
            )
        except (OSError, ValueError, TypeError) as error:
            raise InputError(
                f"--scheduler {self._scheduler}", f"does not answer ({type(error).__name__})",
                "start one with 'dask scheduler', and give the address that it prints",
            ) from None  # fmt: skip
        threads = [w["nthreads"] for w in client.scheduler_info(n_workers=-1)["workers"].values()]
        if not threads:
            note = "has no workers yet; waiting. Start some with 'dask worker ADDRESS --nthreads 1'"
            print(f"{self._scheduler} {note}", file=sys.stderr, flush=True)
        elif max(threads) > 1:
            note = "runs one case at a time in each process: start workers with --nthreads 1"
            print(f"{self._scheduler} {note}", file=sys.stderr, flush=True)
        return client


class _DaskRun:
    """State of one campaign on a cluster."""

    def __init__(self, dask: Any, client: Any, where: str, tasks: Sequence[CaseTask]) -> None:
        self._dask, self._where = dask, where
        self._client, self._tasks = client, tasks
        self._run, self._numbers = uuid.uuid4().hex[:12], itertools.count()
        self._sent: dict[Any, int] = {}
        self._again: deque[int] = deque()
        self._suspects: deque[int] = deque()
        self._lost: dict[int, int] = {}
        self._workers, self._counted_s = 0, -math.inf
        self._done: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._seen_s = time.monotonic()

    def outcomes(self) -> Iterator[TaskOutcome]:
        """Yield the outcomes of all tasks, those of suspects last."""
        fresh = iter(range(len(self._tasks)))
        while True:
            while len(self._sent) < self._window():
                number = self._again.popleft() if self._again else next(fresh, None)
                if number is None:
                    break
                self._send(number)
            if not self._sent:
                break
            if (outcome := self._next(alone=False)) is not None:
                yield outcome
        while self._again or self._suspects:
            self._send(self._again.popleft() if self._again else self._suspects.popleft())
            if (outcome := self._next(alone=True)) is not None:
                yield outcome

    def _window(self) -> int:
        """Number of cases to keep sent; the workers are counted at most once a second."""
        if time.monotonic() > self._counted_s + 1.0:
            with contextlib.suppress(Exception):  # counted again later
                self._workers = len(self._client.ncores())
            self._counted_s = time.monotonic()
        return AHEAD * max(self._workers, 1)

    def _send(self, number: int) -> None:
        task = self._tasks[number]
        name = f"{task.key}-{self._run}-{next(self._numbers)}"
        future = self._client.submit(run_task, task, key=name, pure=False)
        self._sent[future] = number
        future.add_done_callback(self._done.put)

    def _next(self, *, alone: bool) -> TaskOutcome | None:
        """Outcome of the next case that ends; None if it will run again."""
        future = self._next_done()
        number = self._sent.pop(future)
        status, key = future.status, self._tasks[number].key
        try:
            if status == "finished":
                outcome: TaskOutcome = future.result(timeout=CONNECT_S)
                return outcome
            if status == "error":
                error = future.exception(timeout=CONNECT_S)
                if isinstance(error, self._dask.KilledWorker):
                    if alone:
                        return killed_outcome(key, str(error))
                    self._suspects.append(number)
                    return None
                sentence = " ".join(f"{type(error).__name__}: {error}".split())
                return TaskOutcome(key=key, state="failed", sentence=sentence[:800],
                                   log=f"raised on the worker: {error!r}")  # fmt: skip
        except Exception as error:  # the worker died while its result was being transferred
            status = f"{type(error).__name__}: {error}"
        finally:
            future.release()
        return self._once_more(number, status)

    def _next_done(self) -> Any:
        """Wait for the next case to end; refuse to wait on a cluster without workers."""
        while True:
            with contextlib.suppress(queue.Empty):
                return self._done.get(timeout=LOOK_S)
            self._counted_s = -math.inf
            self._window()
            if self._workers:
                self._seen_s = time.monotonic()
            if self._client.status != "running":
                raise self._gone()
            if time.monotonic() > self._seen_s + EMPTY_S:
                raise InputError(
                    f"--scheduler {self._where}", f"has had no workers for {EMPTY_S:.0f} s",
                    "start some with 'dask worker', and repeat the command: what is done is kept",
                )  # fmt: skip

    def _gone(self) -> InputError:
        return InputError(
            f"--scheduler {self._where}", "is no longer there",
            "start it again and repeat the command: what is done is kept",
        )  # fmt: skip

    def _once_more(self, number: int, status: str) -> TaskOutcome | None:
        if self._client.status != "running":
            raise self._gone()
        self._lost[number] = self._lost.get(number, 0) + 1
        if self._lost[number] > LOST_MOST:
            return killed_outcome(self._tasks[number].key, f"the cluster lost it ({status})")
        self._again.append(number)
        return None
