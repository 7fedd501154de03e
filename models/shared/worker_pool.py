"""Worker processes that end with the command: an interrupt or an error stops them at once."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from typing import Final

THREADS: Final = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Each worker computes on one thread: the workers take all cores already."""


@contextlib.contextmanager
def worker_pool(processes: int) -> Iterator[ProcessPoolExecutor]:
    """Pool of spawned processes.

    Where the body is left by an exception, Ctrl-C included, the workers are terminated: what they
    had begun is lost, so files are written under another name first.

    Parameters
    ----------
    processes : int
        Number of workers.

    Yields
    ------
    ProcessPoolExecutor
        To submit work to.
    """
    os.environ.update(dict.fromkeys(THREADS, "1"))  # set before the processes load numpy
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(
        processes,
        multiprocessing.get_context("spawn"),
        signal.signal,
        (signal.SIGINT, signal.SIG_IGN),  # this process handles Ctrl-C
    )
    try:
        yield pool
    except BaseException:
        for worker in set(multiprocessing.active_children()) - others:
            worker.terminate()
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()
