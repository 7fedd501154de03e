"""Table of the robot's tip predictor on the rig behind the servos, on a payload never trained.

Motions that nothing was trained on (triangle, steps), another payload and link on a trained one
(multisine), a multisine that is stopped on its way, a free decay; then the same runs with an
observer whose stiffness or damping is 20 % off, and runs with an effect hidden in the rig. With
--rig another structure stands behind the servos; its bundle must be trained on trials of it. Writes
OUT/tip_DOFdof.json.

    python -m bench.tip build/bundle_1dof --out build/bench
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from bench.tip.tip_answers import CONTENDERS, Answer, Contenders
from bench.tip.tip_runs import (
    SECONDS,
    STOPPED_S,
    TipRun,
    run_behind_servos,
    run_free_decay,
)
from firmware_py.console import DONE, Progress
from firmware_py.display_units import FRACTION, LENGTH
from firmware_py.inference.bundle import ModelBundle

HIDDEN: Final = {
    "stiffness_softening": 0.15, "hysteresis": 0.3, "creep": 0.3, "backlash": 0.006,
    "prebend": 0.01, "unmodelled_payload": 0.3,
}  # fmt: skip
"""Effects hidden in the rig, in turn, one run of the multisine each."""
WRONG: Final = (("stiffness", 0.8), ("stiffness", 1.2), ("damping", 0.8), ("damping", 1.2))
"""Plants of the observer that are wrong, and by what factor."""
PARTS: Final = ("rest", "motion", "glide", "stop", "free decay")


def main(argv: Sequence[str] | None = None) -> int:
    """Run, print the table, write the figures."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.tip", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("bundle", type=Path, help="complete bundle with a chosen predictor")
    parser.add_argument("--out", type=Path, default=Path("build/bench"), help="build/bench")
    parser.add_argument("--rig", default="default", help="structure behind the servos (default)")
    parser.add_argument("--nominal-only", action="store_true", help="no wrong plants, no effects")
    args = parser.parse_args(argv)
    bundle = ModelBundle.load(args.bundle)
    dof = bundle.manifest.dof
    contenders = Contenders(args.bundle, dof)
    further = {} if args.nominal_only else HIDDEN
    progress = Progress(f"bench.tip {dof}DOF", len(SECONDS) + 2 + len(further))
    runs = []
    for motion, seconds in SECONDS.items():
        runs.append(run_behind_servos(bundle, motion, seconds, rig=args.rig))
        progress.step(motion)
    stopped = run_behind_servos(bundle, "multisine", STOPPED_S, rig=args.rig)
    runs.append(TipRun("stopped", *list(vars(stopped).values())[1:]))
    progress.step("stopped")
    runs.append(run_free_decay(dof, args.rig))
    progress.step("decay")
    document: dict[str, Any] = {
        "dof": dof,
        "rig": args.rig,
        "predictor": bundle.manifest.predictor,
        "bundle_bytes": sum(f.stat().st_size for f in args.bundle.iterdir()),
        "nominal": {run.name: figures(run, contenders.answers(run)) for run in runs},
        "wrong": {},
    }
    for what, factor in WRONG if further else ():
        changes = contenders.wrong_plant(what, factor)
        document["wrong"][f"{what} x {factor}"] = {
            run.name: figures(run, contenders.answers(run, changes)) for run in runs
        }
    for effect, strength in further.items():
        run = run_behind_servos(
            bundle, "multisine", SECONDS["multisine"], {effect: strength}, args.rig
        )
        document["wrong"][f"{effect}={strength}"] = {
            run.name: figures(run, contenders.answers(run))
        }
        progress.step(effect)
    document["summary"] = claimed_figures(document)
    args.out.mkdir(parents=True, exist_ok=True)
    path = args.out / f"tip_{dof}dof.json"
    path.write_text(json.dumps(document, indent=1), encoding="utf-8")
    print(table(document))
    print(f"see {path}")
    return DONE


def figures(run: TipRun, answers: Mapping[str, Answer]) -> dict[str, dict[str, dict[str, float]]]:
    """Figures by contender and part of the run; "all" for all parts.

    Parameters
    ----------
    run : TipRun
        With the true tip.
    answers : mapping of str to Answer
        By contender.
    """
    found: dict[str, dict[str, dict[str, float]]] = {}
    known = np.isfinite(run.tip_m).all(axis=1)
    for name in CONTENDERS:
        answer = answers[name]
        error_m = run.tip_m - answer.tip_m
        distance_m = np.linalg.norm(error_m, axis=1)
        inside = np.abs(error_m) <= answer.half_width_m
        found[name] = {}
        for part in ("all", *PARTS):
            rows = known & ((run.part == part) | (part == "all"))
            if not rows.any():
                continue
            trusted = rows & answer.in_range
            found[name][part] = {
                "rows": int(rows.sum()),
                "mean_m": float(distance_m[rows].mean()),
                "max_m": float(distance_m[rows].max()),
                "coverage": float(inside[rows].mean()),
                "in_range": float(answer.in_range[rows].mean()),
                "coverage_in_range": float(inside[trusted].mean()) if trusted.any() else 1.0,
                "max_in_range_m": float(distance_m[trusted].max(initial=0.0)),
                "half_width_m": float(answer.half_width_m[rows].mean()),
            }
    return found


def claimed_figures(document: Mapping[str, Any]) -> dict[str, float]:
    """Figures that the claims state, of the deployed predictor."""
    nominal = {name: run["deployed"] for name, run in document["nominal"].items()}
    motions = [nominal[name]["all"] for name in SECONDS]
    swinging = [nominal["decay"]["all"], nominal["stopped"]["stop"]]
    parts = [part for run in nominal.values() for name, part in run.items() if name != "all"]
    wrong = [run["deployed"]["all"] for runs in document["wrong"].values() for run in runs.values()]
    found = {
        "mean_m": max(m["mean_m"] for m in motions),
        "max_m": max(m["max_m"] for m in motions),
        "swinging_max_in_range_m": max(m["max_in_range_m"] for m in swinging),
        "decay_in_range": nominal["decay"]["free decay"]["in_range"],
        "coverage_smallest": min(p["coverage"] for p in parts),
        "coverage_largest": max(p["coverage"] for p in parts),
        "coverage_mean": float(np.mean([m["coverage"] for m in motions])),
    }
    if wrong:
        found["wrong_coverage_in_range_smallest"] = min(w["coverage_in_range"] for w in wrong)
        found["wrong_coverage_in_range_mean"] = float(
            np.mean([w["coverage_in_range"] for w in wrong])
        )
    return found


def table(document: Mapping[str, Any]) -> str:
    """Return the figures as text, in mm and %.

    Parameters
    ----------
    document : mapping
        As written.
    """
    lines = [
        f"{document['dof']}DOF, deployed: {document['predictor']}; mean / largest in mm; the "
        "interval covers, and in range, in %",
        f"{'run':34}" + "".join(f"{name:>34}" for name in CONTENDERS),
    ]
    groups = {"": document["nominal"], **{f"{k}: ": v for k, v in document["wrong"].items()}}
    for group, runs in groups.items():
        for run, by_contender in runs.items():
            for part in by_contender["deployed"]:
                if group and part != "all":
                    continue
                cells = [_cell(by_contender[name].get(part)) for name in CONTENDERS]
                label = f"{group}{run}" if part == "all" else f"    {part}"
                lines.append(f"{label:34}" + "".join(f"{cell:>34}" for cell in cells))
    return "\n".join(lines)


def _cell(figures: Mapping[str, float] | None) -> str:
    if figures is None:
        return ""
    error = f"{LENGTH.number(figures['mean_m'])} / {LENGTH.number(figures['max_m'])}"
    if not np.isfinite(figures["half_width_m"]):
        return error
    covers, in_range = FRACTION.number(figures["coverage"], 1), FRACTION.number(figures["in_range"])
    return f"{error}  {covers}  {in_range}"


if __name__ == "__main__":
    raise SystemExit(main())
