"""Cost plan of a campaign: time, memory and disk for a number of cases and workers.

The plan extrapolates from the cases in `costs.csv`. Times are processor times; a machine that other
programs use takes longer. The start of a worker is measured separately.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Final

import numpy as np

from firmware_py.core.documents import Document
from firmware_py.core.errors import InputError
from firmware_py.core.units import DATA_SIZE, LARGE_DATA_SIZE
from hil.campaign.code_version import ROOT

SAMPLE: Final = 5
"""Number of cases that a plan needs; if fewer have run with this code, they are run [assumed]."""
OVERHEAD_S: Final = 0.004
"""Time of the campaign's own process for each case: task, result file, row of costs."""
BLOCK_BYTES: Final = 4096
"""Disk space of the smallest file."""
TASK_BYTES: Final = 2500
"""Memory of the campaign's process for each case: 800 for key and configuration, measured on 20,000
cases of kind sil; the rest for its row of the page [assumed]."""


class CostPlan(Document, frozen=True, kw_only=True):
    """Estimated cost of a campaign."""

    MADE_BY: ClassVar[str] = "dropstitch campaign --dry-run"

    kind: str  # Kind of the cases
    cases: int  # Number of cases
    workers: int  # Number of workers
    measured: int  # Number of measured cases behind the estimate
    cpu_s_per_case: float  # Processor time of a case, mean
    cpu_s_p95: float  # Processor time of a case, 95th percentile
    start_s: float  # Processor time of the start of a worker, with the extra time of its first case
    cpu_hours: float  # Processor time of the whole campaign
    wall_hours: float  # Wall-clock time if each worker has a processor to itself
    worker_bytes: int  # Memory of a worker
    workers_bytes: int  # Memory of all workers
    campaign_bytes: int  # Memory of the campaign's process
    result_bytes: int  # Size of a result
    disk_bytes: int  # Disk space of all results, including costs and summary
    command: str  # Command that runs the campaign


def cost_plan(
    kind: str, costs: Sequence[Mapping[str, str]], cases: int, workers: int, start_s: float,
    command: str,
) -> CostPlan:  # fmt: skip
    """Estimate the cost of a campaign from measured costs."""
    done = [row for row in costs if row["state"] == "done"]
    if not done:
        raise InputError(
            "--dry-run", "has no case that ended well to plan from", "see the failures"
        )
    cpu_s = np.array([float(row["cpu_s"]) for row in costs])
    # The first case of each worker reads bundles, compiles and fills caches; its extra time counts
    # as part of the start.
    workers_of = [row["worker"] for row in costs]
    first = np.array([name not in workers_of[:k] for k, name in enumerate(workers_of)])
    later = cpu_s[~first] if (~first).any() else cpu_s
    warm_up_s = max(float(cpu_s[first].mean() - later.mean()), 0.0) if (~first).any() else 0.0
    total_s = cases * float(later.mean()) + workers * (start_s + warm_up_s)
    own_s = cases * OVERHEAD_S
    size = int(np.mean([int(row["result_bytes"]) for row in done]))
    files = cases * math.ceil(size / BLOCK_BYTES) * BLOCK_BYTES
    memory = max(int(row["memory_bytes"]) for row in costs)
    return CostPlan(
        schema=CostPlan.VERSION,
        kind=kind,
        cases=cases,
        workers=workers,
        measured=len(costs),
        cpu_s_per_case=float(later.mean()),
        cpu_s_p95=float(np.quantile(later, 0.95)),
        start_s=start_s + warm_up_s,
        cpu_hours=(total_s + own_s) / 3600,
        wall_hours=max(total_s / min(workers, cases), own_s) / 3600,
        worker_bytes=memory,
        workers_bytes=workers * memory,
        campaign_bytes=100_000_000 + cases * TASK_BYTES,
        result_bytes=size,
        disk_bytes=files + cases * (size + 200),
        command=command,
    )


def worker_start_s(module: str) -> float:
    """Measure the processor time of a new process until it can begin a case of a kind."""
    code = f"import hil.campaign.case_worker; import {module}"
    before, paths = os.times(), [str(ROOT), os.environ.get("PYTHONPATH", "")]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))}
    subprocess.run([sys.executable, "-c", code], check=False, env=environment)
    after = os.times()
    return (after.children_user + after.children_system) - (
        before.children_user + before.children_system
    )


def describe_plan(plan: CostPlan) -> str:
    return "\n".join(
        [
            f"{plan.cases} cases of kind {plan.kind} on {plan.workers} workers, from "
            f"{plan.measured} that ran here:",
            f"  a case      {plan.cpu_s_per_case:.3g} s of a processor (95 %: "
            f"{plan.cpu_s_p95:.3g} s); a worker starts in {plan.start_s:.1f} s",
            f"  time        {plan.cpu_hours:.3g} processor hours, {_span(plan.wall_hours)} if the "
            "workers have theirs alone",
            f"  memory      {_size(plan.worker_bytes)} for a worker, {_size(plan.workers_bytes)} "
            f"for all, {_size(plan.campaign_bytes)} for the campaign itself",
            f"  disk        {_size(plan.disk_bytes)}, {plan.result_bytes} bytes a result",
            f"  command     {plan.command}",
        ]
    )


def _span(hours: float) -> str:
    if hours < 1 / 60:
        return f"{3600 * hours:.0f} s"
    return f"{60 * hours:.0f} min" if hours < 2 else f"{hours:.1f} h"


LARGE_BYTES: Final = 2_000_000_000
"""Size from which the text is in gigabytes."""


def _size(count: int) -> str:
    return DATA_SIZE.text(count) if count < LARGE_BYTES else LARGE_DATA_SIZE.text(count)


def rows_of_code(rows: Sequence[Mapping[str, Any]], code: str) -> list[Mapping[str, Any]]:
    """Return the rows of costs that were measured with one version of the code."""
    return [row for row in rows if row["code"] == code]
