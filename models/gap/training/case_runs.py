"""Runs of data sets with hidden effects: one file of results for each, two at a time.

What has a file is not run again, so a run that was stopped goes on. The files say nothing of the
code: results of other code are deleted by hand.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterable
from concurrent.futures import as_completed
from dataclasses import asdict
from pathlib import Path
from typing import Any

from firmware_py.console import Progress
from models.gap.training.case_run import run_hidden_case
from models.gap.training.cases import HiddenCase
from models.gap.training.rig_plants import plants_of_rigs
from models.plant.plant import read_plant
from models.shared.worker_pool import worker_pool


def run_cases(cases: Iterable[HiddenCase], out: Path) -> int:
    """Run the cases that have no result yet, each with a plant of its rig; return how many failed.

    The traceback of a case that failed stands in OUT/failures.
    """
    wanted = list(cases)
    plants = plants_of_rigs({(c.rig, c.joints, "study") for c in wanted}, out / "plants")
    files = {case_file(out, case): case for case in wanted}
    missing = {path: case for path, case in files.items() if not path.exists()}
    (out / "results").mkdir(parents=True, exist_ok=True)
    progress, failed = Progress("hidden effects", len(missing)), 0
    with worker_pool(2) as pool:
        begun = {
            pool.submit(_write_result, case, plants[case.rig, case.joints, "study"], path): path
            for path, case in missing.items()
        }
        for done in as_completed(begun):
            if (error := done.exception()) is not None:
                failed += 1
                trace = out / "failures" / f"{begun[done].stem}.txt"
                trace.parent.mkdir(exist_ok=True)
                text = f"{missing[begun[done]]}\n{error!r}\n{error.__cause__}\n"
                trace.write_text(text, encoding="utf-8")
            progress.step(missing[begun[done]].kind)
    return failed


def case_file(out: Path, case: HiddenCase) -> Path:
    """File of the result of a case."""
    key = zlib.crc32(json.dumps(asdict(case), sort_keys=True).encode())
    return out / "results" / f"{case.rig}_{case.kind}_{case.seed}_{key:08x}.json"


def case_results(out: Path) -> dict[str, dict[str, Any]]:
    """Results of a run by the stem of their file, each with its case."""
    files = sorted((out / "results").glob("*.json"))
    return {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in files}


def _write_result(case: HiddenCase, plant: Path, path: Path) -> None:
    result = {"case": asdict(case), **run_hidden_case(case, read_plant(plant))}
    fresh = path.with_suffix(".part")
    fresh.write_text(json.dumps(result, indent=1), encoding="utf-8")
    fresh.replace(path)
