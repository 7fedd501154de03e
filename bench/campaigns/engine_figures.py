"""One campaign on processes, and on a dask cluster of which one worker is killed three times."""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path
from typing import Any, Final

from bench.campaigns.local_cluster import WORKERS, local_cluster
from hil.campaign.campaign_cases import CampaignCase, CaseMaker
from hil.campaign.campaign_run import run_campaign_cases
from hil.campaign.campaign_spec import configurations, read_spec
from hil.campaign.campaign_summary import write_summary
from hil.campaign.engines.dask_engine import DaskEngine
from hil.campaign.engines.engine import Engine
from hil.campaign.engines.process_engine import ProcessEngine
from hil.campaign.kinds.case_kind import load_kind
from hil.campaign.result_store import ResultStore

KILLS: Final = 3


def engines_side_by_side(spec_path: Path, directory: Path) -> dict[str, Any]:
    """Figures of one campaign on both engines."""
    os.environ["OMP_NUM_THREADS"] = "1"
    spec = read_spec(spec_path)
    maker = CaseMaker(load_kind(spec.kind), spec.kind, directory / "shared")
    cases = maker.cases(configurations(spec), str(spec_path))
    engine: Engine = ProcessEngine(WORKERS, directory / "logs")
    found = {"processes": _timed(cases, maker, directory / "processes", engine)}
    with local_cluster() as cluster:
        killer = WorkerKiller(cluster, directory / "dask" / "costs.csv", len(cases))
        killer.start()
        engine = DaskEngine(cluster.scheduler_address)
        found["dask"] = _timed(cases, maker, directory / "dask", engine)
        killer.done.set()
        killer.join()
    both = [(directory / name / "summary.csv").read_bytes() for name in found]
    return found | {"kills": killer.kills, "summaries_equal": float(both[0] == both[1])}


class WorkerKiller(threading.Thread):
    """Thread that kills one worker, and its successors, each time a quarter of the cases is
    done.
    """

    def __init__(self, cluster: Any, costs: Path, cases: int) -> None:
        super().__init__(daemon=True)
        self._cluster, self._costs, self._cases = cluster, costs, cases
        self.done, self.kills = threading.Event(), 0

    def run(self) -> None:
        """See `threading.Thread.run`."""
        while self.kills < KILLS and not self.done.wait(0.2):
            ended = self._costs.read_bytes().count(b"\n") - 1 if self._costs.exists() else 0
            if ended * (KILLS + 1) > self._cases * (self.kills + 1) and self._kill():
                self.kills += 1

    def _kill(self) -> bool:
        process = self._cluster.workers[0].process
        if process is None or process.pid is None:
            return False
        os.kill(process.pid, signal.SIGKILL)
        return True


def _timed(
    cases: list[CampaignCase], maker: CaseMaker, directory: Path, engine: Engine
) -> dict[str, Any]:
    store, start_s = ResultStore(directory), time.perf_counter()
    counts = run_campaign_cases(cases, maker, store, engine)
    size = write_summary(cases, store, directory / "summary.csv")
    costs = store.read_costs()
    return {
        "cases": len(cases),
        "done": counts.ran.get("done", 0),
        "seconds": time.perf_counter() - start_s,
        "cpu_s_per_case": sum(float(row["cpu_s"]) for row in costs) / len(costs),
        "memory_bytes": max(int(row["memory_bytes"]) for row in costs),
        "result_bytes": sum(int(row["result_bytes"]) for row in costs) / len(costs),
        "summary_bytes": size,
    }
