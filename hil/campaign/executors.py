"""Run of a campaign on one of two executors: processes of this machine, or a dask cluster.

Both are executors of `concurrent.futures`, so `run_cases` does not know which it has. They differ
in what a worker's death does. A process has one case at a time, so exactly one can be the cause.
The scheduler of dask suspects every case that was assigned to the dead worker, and gives a case up
after `distributed.scheduler.allowed-failures` deaths; of the cluster that is started here, after
the first.
"""

from __future__ import annotations

import contextlib
import faulthandler
import itertools
import logging
import multiprocessing
import os
import queue
import signal
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError, Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

from firmware_py.core.console import Progress, terminations_raised
from firmware_py.core.errors import InputError
from hil.campaign.cases import CampaignCase, CaseMaker
from hil.campaign.store import ResultStore
from hil.campaign.worker import MOST_LOG, CaseOutcome, CaseTask, run_case
from models.shared.worker_pool import THREADS, end_with_parent

ATTEMPTS: Final = 3
"""Attempts at a case whose worker dies. The cause may lie elsewhere, such as memory that another
program used up, but a case that kills every worker has to end [assumed]."""
CONNECT_S: Final = 10.0
"""Timeout of the answer of dask's scheduler [assumed]."""
REPLACE_S: Final = 5.0
"""Period of checks of the cluster that is started here for dead workers [assumed]."""
LOST_S: Final = 60.0
"""Time until that cluster replaces a dead worker whose nanny has not; a loaded machine needs 20 s
to start one."""
AHEAD: Final = 1000
"""Cases sent ahead to dask, whose scheduler gives them to workers as they become idle [assumed]."""


class Workers(NamedTuple):
    """Executor, and what `run_tasks` has to know of it."""

    executor: Executor
    ahead: int  # Number of cases to send before one has ended
    died: type[Exception]  # What a future raises if the worker of its case died


def run_cases(
    cases: Sequence[CampaignCase],
    maker: CaseMaker,
    store: ResultStore,
    workers: contextlib.AbstractContextManager[Workers],
) -> dict[str, int]:
    """Run the cases without a valid result; store each outcome as soon as it arrives.

    Returns the number of earlier results, of damaged ones, and of cases that ran by outcome.
    """
    missing = {case.key: case for case in cases if store.read(case.key) is None}
    damaged = sum(store.path(key).exists() for key in missing)
    if damaged:
        print(f"{damaged} results are damaged and run again", file=sys.stderr)
    ran: Counter[str] = Counter()
    if missing:
        progress = Progress("campaign", len(missing))
        progress.begin("starting workers")
        with terminations_raised(), workers as started:
            for task, outcome in run_tasks(map(maker.task, missing.values()), started):
                store.add(missing[task.key], maker.kind.name, maker.code, outcome)
                ran[outcome.state] += 1
                bad = ran.total() - ran["done"]
                progress.step(f"{bad} without result" if bad else "")
    return {"kept": len(cases) - len(missing), "damaged": damaged, **+ran}


def run_tasks(
    tasks: Iterable[CaseTask], workers: Workers
) -> Iterator[tuple[CaseTask, CaseOutcome]]:
    """Yield each task with its outcome, as they end.

    A case whose worker dies begins anew at the end, alone, until it has had `ATTEMPTS`.
    """
    ahead = workers.ahead
    for attempt in range(1, ATTEMPTS + 1):
        suspects: list[CaseTask] = []
        for task, outcome in _run(tasks, workers, ahead):
            if outcome.state == "killed" and attempt < ATTEMPTS:
                suspects.append(task)
            else:
                yield task, outcome
        tasks, ahead = suspects, 1


def _run(
    tasks: Iterable[CaseTask], workers: Workers, ahead: int
) -> Iterator[tuple[CaseTask, CaseOutcome]]:
    waiting, running = iter(tasks), dict[Future[CaseOutcome], CaseTask]()
    ended = queue.SimpleQueue[Future[CaseOutcome]]()
    outcomes: list[tuple[CaseTask, CaseOutcome]] = []
    while True:
        for task in itertools.islice(waiting, ahead - len(running)):
            future = workers.executor.submit(run_case, task)
            running[future] = task
            future.add_done_callback(ended.put)
        yield from outcomes  # after the next case is sent: no worker waits for the disk
        if not running:
            return
        future = ended.get()
        outcomes = [(running.pop(future), _outcome(future, workers.died))]


def _outcome(future: Future[CaseOutcome], died: type[Exception]) -> CaseOutcome:
    try:
        return future.result()
    except CancelledError:
        raise InputError(
            "the cluster", "is no longer there",
            "start it again, and repeat the command: results that are there count",
        ) from None  # fmt: skip
    except died as error:
        sentence = "its worker died each time that it was begun"
        return CaseOutcome(state="killed", sentence=sentence, log=str(error))
    except Exception as error:  # as of a worker of a cluster without this code
        sentence = " ".join(f"{type(error).__name__}: {error}".split())[:800]
        return CaseOutcome(state="failed", sentence=sentence, log=f"on the worker: {error!r}")


class WorkerDied(Exception):
    """A worker process died; the message ends with what it wrote in its last case."""


@contextlib.contextmanager
def process_workers(count: int, logs: Path) -> Iterator[Workers]:
    """Processes of this machine; each writes what its case prints to a file in `logs`."""
    os.environ.update(dict.fromkeys(THREADS, "1"))  # set before the processes load NumPy
    logs.mkdir(parents=True, exist_ok=True)
    others, executor = set(multiprocessing.active_children()), _Processes(count, logs)
    try:
        yield Workers(executor, count, WorkerDied)
    except BaseException:  # also Ctrl-C: running cases are lost
        for worker in set(multiprocessing.active_children()) - others:
            worker.terminate()
        raise
    finally:
        executor.shutdown()


class _Processes(Executor):
    """Pools of one process each: a larger pool ends all its cases with the first dead process."""

    def __init__(self, count: int, logs: Path) -> None:
        self._logs, self._pools = logs, dict[int, ProcessPoolExecutor]()
        self._idle = queue.SimpleQueue[int]()
        for number in range(count):
            self._idle.put(number)

    def submit(self, run: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Run a call in an idle process; wait until there is one."""
        number, future = self._idle.get(), Future[Any]()
        if number not in self._pools:
            self._log(number).touch()
            self._pools[number] = ProcessPoolExecutor(
                1, multiprocessing.get_context("spawn"), _begin_worker, (str(self._log(number)),)
            )
        try:
            inner = self._pools[number].submit(_run_logged, run, *args, **kwargs)
        except BrokenProcessPool as error:  # it died after its last case
            inner = Future()
            inner.set_exception(error)
        inner.add_done_callback(partial(self._end, number, future))
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        for pool in list(self._pools.values()):  # a worker that dies meanwhile leaves it
            pool.shutdown(wait, cancel_futures=cancel_futures)

    def _end(self, number: int, future: Future[Any], inner: Future[Any]) -> None:
        error = inner.exception()
        if isinstance(error, BrokenProcessPool):
            self._pools.pop(number).shutdown(wait=False)
            written = self._log(number).read_text(encoding="utf-8", errors="replace")[-MOST_LOG:]
            error = WorkerDied(f"the worker ended without an answer\n{written}".strip())
        self._idle.put(number)
        if error is None:
            future.set_result(inner.result())
        else:
            future.set_exception(error)

    def _log(self, number: int) -> Path:
        return self._logs / f"worker-{number}.log"


def _begin_worker(log: str) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the command handles Ctrl-C
    end_with_parent()
    descriptor = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    for stream in (1, 2):
        os.dup2(descriptor, stream)
    faulthandler.enable()


def _run_logged(run: Callable[..., Any], *args: Any) -> Any:
    os.ftruncate(1, 0)  # the log of this process holds its last case alone
    return run(*args)


@contextlib.contextmanager
def dask_workers(scheduler: str | None, count: int) -> Iterator[Workers]:
    """Workers of a cluster, or of one on this machine that is started with `count` workers."""
    try:
        import dask  # an optional dependency
        import distributed
    except ImportError:
        raise InputError(
            "--executor dask", "needs an extra that is not installed",
            "run: python -m pip install 'dropstitch[dask]'",
        ) from None  # fmt: skip
    for logger in ("distributed", "distributed.client"):
        logging.getLogger(logger).setLevel(logging.CRITICAL)
    with contextlib.ExitStack() as stack:
        if scheduler is None:
            lost = {"distributed.deploy.lost-worker-timeout": LOST_S}
            stack.enter_context(dask.config.set(lost))
            cluster = stack.enter_context(
                distributed.LocalCluster(
                    n_workers=count, threads_per_worker=1, dashboard_address=None,
                    memory_limit=None, silence_logs=logging.CRITICAL,
                )
            )  # fmt: skip
            cluster.scheduler.allowed_failures = 0

            def replace_dead() -> None:
                # A nanny does not replace a worker that died while it started; the cluster does
                # after `LOST_S` if it is asked.
                if cluster.status.name == "running":
                    cluster.scale(count)
                    cluster.loop.call_later(REPLACE_S, replace_dead)

            cluster.loop.add_callback(replace_dead)
            scheduler = cluster.scheduler_address
        try:
            client = distributed.Client(scheduler, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise InputError(
                f"--scheduler {scheduler}", f"does not answer ({type(error).__name__})",
                "start one with 'dask scheduler', and give the address that it prints",
            ) from None  # fmt: skip
        stack.enter_context(client)
        if not client.ncores():
            note = "has no workers yet; waiting. Start some with 'dask worker ADDRESS --nthreads 1'"
            print(f"{scheduler} {note}", file=sys.stderr, flush=True)
        yield Workers(client.get_executor(pure=False), AHEAD, distributed.KilledWorker)
