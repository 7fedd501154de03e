"""Data sets with one disturbed trial, and how many the diagnosis tells: writes figures as JSON.

    python -m bench.gap.disturbed_trials --rigs drawn_1083 drawn_1084 --out build/bench_disturbed

A plant is identified on each rig. Data sets with nothing hidden and with one effect are diagnosed
as they are, and with one trial disturbed: its payload is written wrong by 1 kg, or by 0.5 kg, or
somebody pushes the link for a moment. The link is the one that the plant was identified on.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from bench.gap.case_run import bench_trials, rig_of
from bench.gap.cases import BenchCase, draw_cases
from bench.gap.rig_plants import plants_of_rigs
from firmware_py.console import DONE, Progress
from models.gap.diagnosis import diagnose
from models.plant.plant import read_plant
from models.shared.worker_pool import worker_pool
from models.trials.trial import Trial, TrialSet

SEED: Final = 148
PUSH_M: Final = 0.04
"""Largest displacement of the tip by a push [chosen before any run]."""
PUSH_S: Final = 0.15
"""Its standard deviation in time."""


def as_recorded(trial: Trial) -> Trial:
    return trial


def payload_off_by(difference_kg: float) -> Callable[[Trial], Trial]:
    """Write the payload wrong, towards 1 kg so that it stays within the link's."""

    def written_wrong(trial: Trial) -> Trial:
        sign = 1.0 if trial.meta.payload_kg < 1.0 else -1.0
        payload_kg = trial.meta.payload_kg + sign * difference_kg
        return replace(trial, meta=msgspec.structs.replace(trial.meta, payload_kg=payload_kg))

    return written_wrong


def pushed(trial: Trial) -> Trial:
    """Trial in which the link is pushed once along x, as a cantilever bends at its end."""
    middle_s = trial.time_s[len(trial) // 2]
    push_m = PUSH_M * np.exp(-0.5 * ((trial.time_s - middle_s) / PUSH_S) ** 2)
    layout, columns = trial.meta.layout, dict(trial.columns)
    along = np.repeat(np.array(layout.rows_m) / layout.rows_m[-1], layout.corners)
    for name, height in zip((*layout.names, "tip"), (*along, 1.0), strict=True):
        columns[f"{name}_x_m"] = columns[f"{name}_x_m"] + push_m * height**2
    return replace(trial, columns=columns)


DISTURBANCES: Final[Mapping[str, Callable[[Trial], Trial]]] = {
    "none": as_recorded,
    "payload_1_kg": payload_off_by(1.0),
    "payload_0_5_kg": payload_off_by(0.5),
    "push": pushed,
}


def diagnose_disturbed(case: BenchCase, plant: Path, name: str) -> dict[str, Any]:
    """Diagnose a data set with its last trial disturbed."""
    trials = bench_trials(rig_of(case).hide(case.hidden), case.seed)
    disturb = DISTURBANCES[name]
    found = diagnose(read_plant(plant), TrialSet((*trials[:-1], disturb(trials[-1]))))
    odd = [trial.name for trial in found.odd]
    return {
        "rig": case.rig,
        "hidden": list(case.hidden),
        "disturbance": name,
        "odd": odd,
        "told": trials[-1].name in odd,
        "false": len(set(odd) - ({trials[-1].name} if name != "none" else set())),
        "verdict": found.verdict,
        "named": list(found.named),
        "right": list(found.named) == list(case.hidden)
        and (bool(case.hidden) or found.verdict == "no gap"),
    }


def figures_of(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Counts by disturbance."""
    return {
        name: {
            "of": len(own),
            "told": sum(r["told"] for r in own),
            "false": sum(r["false"] for r in own),
            "right": sum(r["right"] for r in own),
        }
        for name in DISTURBANCES
        for own in [[r for r in rows if r["disturbance"] == name]]
    }


def main(argv: Sequence[str] | None = None) -> int:
    """Identify, diagnose, print the figures as JSON."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.gap.disturbed_trials", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("--rigs", nargs="+", required=True, metavar="NAME")
    parser.add_argument("--out", type=Path, required=True, help="directory of plants and results")
    args = parser.parse_args(argv)
    plants = plants_of_rigs([(rig, 1, "study") for rig in args.rigs], args.out / "plants")
    work = [
        (case, plants[rig, 1, "study"], name)
        for rig in args.rigs
        for case in two_cases_of(rig)
        for name in DISTURBANCES
    ]
    progress, rows = Progress("disturbed trials", len(work)), []
    with worker_pool(2) as pool:
        for done in as_completed([pool.submit(diagnose_disturbed, *each) for each in work]):
            rows.append(done.result())
            progress.step(f"{rows[-1]['rig']}, {rows[-1]['disturbance']}")
    document = figures_of(rows) | {"cases": rows}
    (args.out / "disturbed.json").write_text(json.dumps(document, indent=1))
    print(json.dumps(document, indent=1))
    return DONE


def two_cases_of(rig: str) -> list[BenchCase]:
    """Data sets of a rig: nothing hidden, and its first effect of the size that matters."""
    cases = list(draw_cases(1, 1, 0, 0, SEED, rig, same_link=True))
    return [next(c for c in cases if c.kind == "null"), cases[0]]


if __name__ == "__main__":
    raise SystemExit(main())
