"""Local dask cluster for the benchmarks, set up as docs/campaigns.md says."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any, Final

import dask
import distributed

WORKERS: Final = 2


@contextlib.contextmanager
def local_cluster() -> Iterator[Any]:
    """Scheduler in this process and workers of one thread each, without dask's own profiler.

    The profiler takes a sample each 10 ms in the scheduler and in each worker.
    """
    unprofiled = dask.config.set({"distributed.worker.profile.enabled": False})
    with unprofiled, distributed.LocalCluster(
        n_workers=WORKERS, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:  # fmt: skip
        yield cluster
