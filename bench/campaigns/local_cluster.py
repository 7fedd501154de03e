"""Local dask cluster for the benchmarks."""

from __future__ import annotations

from typing import Any, Final

import distributed

WORKERS: Final = 2


def local_cluster() -> Any:
    """Scheduler in this process, and workers of one thread each in processes of their own."""
    return distributed.LocalCluster(
        n_workers=WORKERS, threads_per_worker=1, processes=True, dashboard_address=None
    )
