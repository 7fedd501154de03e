"""Faults written into recordings of a real servo, and which of them the gap workflow names.

    python -m bench.faulty_recordings DATA --out build/faulty_recordings

The plant of the XL330 pendulum (Rhoban/bam) is identified on the six logs of two position gains.
The logs of the other two gains are diagnosed, as they are and with one fault written into each: a
weight or a gain that is declared wrong, an encoder that is off, an angle that is read late. All
else is as recorded, the error of the plant's equations included. Every pair of gains is left out in
turn. Writes OUT/figures.json and prints it.
"""

from __future__ import annotations

import argparse
import itertools
import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from bench.rates import rate
from bench.real import EXAMPLES, SYSTEMS, gain_of, import_recordings
from firmware_py.core.console import DONE, Progress
from models.gap.diagnosis import diagnose
from models.plant.identification.identify import identify
from models.plant.plant import read_plant
from models.shared.worker_pool import worker_pool
from models.trials.files import read_trials
from models.trials.trial import Trial, TrialSet

SYSTEM: Final = SYSTEMS["xl330_pendulum"]
EFFECTS: Final = ("load_dependent_friction", "stribeck_friction")
"""What the gap workflow names on all twelve logs."""

LATE_ROWS: Final = 12
"""60 ms."""


def declared(condition: str, factor: float) -> Callable[[Trial], Trial]:
    """Declare a condition wrong by a factor."""

    def written_wrong(trial: Trial) -> Trial:
        conditions = dict(trial.meta.conditions)
        conditions[condition] *= factor
        return replace(trial, meta=msgspec.structs.replace(trial.meta, conditions=conditions))

    return written_wrong


def with_encoder_off(trial: Trial) -> Trial:
    """Trial whose encoder reads 50 mrad too much."""
    angle_rad = trial.columns["angle_1_rad"] + 0.05
    return replace(trial, columns={**trial.columns, "angle_1_rad": angle_rad})


def with_late_angle(trial: Trial) -> Trial:
    """Trial whose angle is read late."""
    angle_rad = trial.columns["angle_1_rad"]
    late_rad = np.concatenate([np.full(LATE_ROWS, angle_rad[0]), angle_rad[:-LATE_ROWS]])
    return replace(trial, columns={**trial.columns, "angle_1_rad": late_rad})


FAULTS: Final[Mapping[str, tuple[Callable[[Trial], Trial], frozenset[str]]]] = {
    "nothing": (lambda trial: trial, frozenset()),
    "weight declared 25 % low": (declared("mass_kg", 0.75), frozenset({"unmodelled_payload"})),
    "gain declared 30 % high": (
        declared("duty_gain_1", 1.3), frozenset({"position_gain_change"}),
    ),
    "encoder off by 50 mrad": (with_encoder_off, frozenset({"encoder_offset"})),
    "angle read 60 ms late": (with_late_angle, frozenset({"sensor_lag", "dead_time"})),
}  # fmt: skip
"""Each fault, and the effects that describe it: an angle that is read late and a servo that acts
late look the same but for the first rows."""


def plant_without(gains: Sequence[float], trials: TrialSet, out: Path) -> Path:
    """Plant that is identified on the logs of all position gains but some (1/rad)."""
    path = out / ("without_" + "_".join(f"{g:.3f}" for g in gains) + ".json")
    if not path.exists():
        start = read_plant(EXAMPLES / f"{SYSTEM.name}.toml").with_effects(*EFFECTS)
        rest = TrialSet(tuple(t for t in trials if gain_of(t) not in gains))
        identify(start, rest, noise_floor=False).plant.write(path)
    return path


def diagnose_faulty(
    trials: Path, gains: Sequence[float], plant: Path, fault: str
) -> dict[str, Any]:
    """Diagnose the logs of some position gains with a fault, by a plant of the others."""
    known = read_plant(plant)
    change, effects = FAULTS[fault]
    changed = [change(t) for t in read_trials(trials, known.signals) if gain_of(t) in gains]
    diagnosis = diagnose(known, TrialSet(tuple(changed)))
    alike = {e for sets in diagnosis.look_alikes.values() for fit in sets for e in fit.candidates}
    alike -= set(diagnosis.named)
    right = bool(effects & set(diagnosis.named)) if effects else not diagnosis.named
    return {
        "gains": list(gains),
        "fault": fault,
        "named": list(diagnosis.named),
        "alike": sorted(alike),
        "right": right,
        "class_right": right or bool(diagnosis.named and effects & alike),
        "verdict": diagnosis.verdict,
        "gap_left_fraction": diagnosis.gap_left_fraction,
    }


def fault_figures(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Figures by fault, and of all faults together."""
    faulty = [r for r in rows if r["fault"] != "nothing"]
    return {
        "by_fault": {
            fault: rate([r["right"] for r in rows if r["fault"] == fault]) for fault in FAULTS
        },
        "named": rate([r["right"] for r in faulty]),
        "class_right": rate([r["class_right"] for r in faulty]),
        "wrong": rate([bool(r["named"]) and not r["class_right"] for r in faulty]),
    }


def main(argv: Sequence[str] | None = None) -> int:
    """Import, identify, diagnose, print the figures as JSON."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.faulty_recordings", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("data", type=Path, help="folder of all recordings")
    parser.add_argument("--out", type=Path, required=True, help="directory of plants and figures")
    args = parser.parse_args(argv)
    trials = import_recordings(SYSTEM, args.data, args.out / "trials")
    pairs = list(itertools.combinations(sorted({gain_of(t) for t in trials}), 2))
    progress, rows = Progress("faulty recordings", len(pairs) * len(FAULTS)), []
    with worker_pool(2) as pool:
        plants = [pool.submit(plant_without, pair, trials, args.out) for pair in pairs]
        work = [
            pool.submit(diagnose_faulty, args.out / "trials", pair, plant.result(), fault)
            for pair, plant in zip(pairs, plants, strict=True)
            for fault in FAULTS
        ]
        for done in as_completed(work):
            rows.append(done.result())
            progress.step(rows[-1]["fault"])
    rows.sort(key=lambda r: (r["gains"], list(FAULTS).index(r["fault"])))
    document = fault_figures(rows) | {"cases": rows}
    (args.out / "figures.json").write_text(json.dumps(document, indent=1))
    print(json.dumps(document, indent=1))
    return DONE


if __name__ == "__main__":
    raise SystemExit(main())
