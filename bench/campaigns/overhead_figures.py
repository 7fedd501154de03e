"""Overhead of a campaign for each case, beside cases of 0.5 s that only compute.

While two workers are busy, the overhead of a case is the time that its worker stands idle around
it, and the processor time of the campaign's own process, which takes it from a worker where there
are no more processors than workers. Both are measured in one run with the cases themselves, so that
a host that is preempted slows all alike.
"""

from __future__ import annotations

import os
import resource
import time
from pathlib import Path
from typing import Any, Final

from bench.campaigns.busy_kind import KIND, rounds_for
from bench.campaigns.local_cluster import WORKERS, local_cluster
from hil.campaign.campaign_cases import CaseMaker
from hil.campaign.campaign_run import LazyTasks
from hil.campaign.engines.dask_engine import DaskEngine
from hil.campaign.engines.engine import Engine
from hil.campaign.engines.process_engine import ProcessEngine
from hil.campaign.result_store import ResultStore

CASE_S: Final = 0.5


def overhead_by_engine(cases: int, directory: Path) -> dict[str, Any]:
    """Overhead of processes and of a local dask cluster."""
    os.environ["OMP_NUM_THREADS"] = "1"
    rounds = rounds_for(CASE_S)
    found = {}
    found["processes"] = _overhead(
        ProcessEngine(WORKERS, directory / "logs"), rounds, cases, directory / "processes"
    )
    with local_cluster() as cluster:
        found["dask"] = _overhead(
            DaskEngine(cluster.scheduler_address), rounds, cases, directory / "dask"
        )
    return found


def _overhead(engine: Engine, rounds: int, count: int, directory: Path) -> dict[str, float]:
    maker, store = CaseMaker(KIND, "bench.campaigns.busy_kind", directory), ResultStore(directory)
    cases = maker.cases(({"rounds": rounds, "seed": k} for k in range(count)), "bench")
    by_key = {case.key: case for case in cases}
    edge, before = 2 * WORKERS, resource.getrusage(resource.RUSAGE_SELF)
    ends_s, walls_s, cpu_s = [], [], []
    own = [before]
    for outcome in engine.outcomes(LazyTasks(maker, cases)):
        case = by_key[outcome.key]
        store.write(case.key, "busy", maker.code, case.config, outcome.result)
        store.add_cost(maker.code, outcome, 0)
        if outcome.cost is not None:
            ends_s.append(time.perf_counter())
            walls_s.append(outcome.cost.wall_s)
            cpu_s.append(outcome.cost.cpu_s)
            own.append(resource.getrusage(resource.RUSAGE_SELF))
    inner = slice(edge, count - edge)  # both workers are busy from the first to the last
    n = count - 2 * edge
    span_s = ends_s[count - edge - 1] - ends_s[edge - 1]
    idle_s = WORKERS * span_s / n - sum(walls_s[inner]) / n
    first, last = own[edge], own[count - edge]
    own_s = (last.ru_utime + last.ru_stime - first.ru_utime - first.ru_stime) / n
    case_s = sum(cpu_s[inner]) / n
    return {
        "cases": count,
        "case_cpu_s": case_s,
        "case_wall_s": sum(walls_s[inner]) / n,
        "idle_s": idle_s,
        "own_cpu_s": own_s,
        "overhead_fraction": (max(idle_s, 0.0) + own_s) / case_s,
    }
