"""Long work of many jobs, each of which writes one file: what has a file is not done again."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Mapping
from concurrent.futures import as_completed
from pathlib import Path

from firmware_py.core.console import Progress
from models.shared.worker_pool import worker_pool


def make_missing(
    label: str,
    jobs: Mapping[Path, Callable[[], None]],
    workers: int = 2,
    failures: Path | None = None,
) -> int:
    """Run the jobs whose file does not exist, and return how many failed.

    Progress says how long the rest will take. With `failures` a failed job leaves its traceback in
    that directory and the others go on; otherwise its error is raised.
    """
    missing = {path: job for path, job in jobs.items() if not path.exists()}
    if not missing:
        return 0
    for path in missing:
        path.parent.mkdir(parents=True, exist_ok=True)
    progress, start_s, failed = Progress(label, len(missing)), time.monotonic(), 0
    progress.begin("each takes minutes")
    with worker_pool(workers) as pool:
        begun = {pool.submit(job): path for path, job in missing.items()}
        for count, job in enumerate(as_completed(begun), 1):
            name = begun[job].stem
            if error := job.exception():
                if failures is None:
                    raise error
                failed += 1
                failures.mkdir(parents=True, exist_ok=True)
                text = "".join(traceback.format_exception(error))
                (failures / f"{name}.txt").write_text(text, encoding="utf-8")
            remaining_s = (time.monotonic() - start_s) / count * (len(missing) - count)
            progress.step(f"{name}, {remaining_s / 60:.0f} min remain" if remaining_s else name)
    return failed
