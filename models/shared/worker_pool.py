"""Worker processes that end with the command: an interrupt or an error stops them at once."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.process import BaseProcess
from typing import Final

from firmware_py.core.console import terminations_raised
from firmware_py.core.errors import InputError

THREADS: Final = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Each worker computes on one thread: the workers already use all cores."""


@contextlib.contextmanager
def worker_pool(processes: int) -> Iterator[ProcessPoolExecutor]:
    """Pool of spawned processes.

    If an exception leaves the body, also Ctrl-C or SIGTERM, the workers are terminated and lose
    what they began, so files are written under another name first. The workers also end if this
    process is killed.
    """
    os.environ.update(dict.fromkeys(THREADS, "1"))  # set before the processes load numpy
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(
        processes, multiprocessing.get_context("spawn"), initializer=_begin_worker
    )
    with terminations_raised():
        try:
            yield pool
            pool.shutdown()
        except BaseException as error:
            for worker in set(multiprocessing.active_children()) - others:
                worker.terminate()
            pool.shutdown(wait=False, cancel_futures=True)
            if isinstance(error, BrokenProcessPool):
                raise InputError(
                    f"--workers {processes}",
                    "one of the processes was killed, as happens where the memory runs out",
                    "free memory, or give fewer workers",
                ) from None
            raise


def _begin_worker() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the command handles Ctrl-C
    end_with_parent()


def end_with_parent() -> None:
    """End this process at once when its parent has ended, even by SIGKILL."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_after, args=(parent,), daemon=True).start()


def _end_after(parent: BaseProcess) -> None:
    parent.join()
    os._exit(1)  # no clean-up: the main thread may be in the middle of anything
