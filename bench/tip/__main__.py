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

from bench.tip.tip_answers import CONTENDERS, Contenders
from bench.tip.tip_figures import claimed_figures, figures
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
from models.learning.axis_coverage import coverage_text

HIDDEN: Final = {
    "stiffness_softening": 0.15, "hysteresis": 0.3, "creep": 0.3, "backlash": 0.006,
    "prebend": 0.01, "unmodelled_payload": 0.3,
}  # fmt: skip
"""Effects hidden in the rig, in turn, one run of the multisine each."""
WRONG: Final = (("stiffness", 0.8), ("stiffness", 1.2), ("damping", 0.8), ("damping", 1.2))
"""Plants of the observer that are wrong, and by what factor."""


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


def table(document: Mapping[str, Any]) -> str:
    """Return the figures as text, in mm and %."""
    lines = [
        f"{document['dof']}DOF, deployed: {document['predictor']}; mean / largest in mm; the "
        "interval covers, mean / worst axis, and in range, in %",
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


def _cell(figures: Mapping[str, Any] | None) -> str:
    if figures is None:
        return ""
    error = f"{LENGTH.number(figures['mean_m'])} / {LENGTH.number(figures['max_m'])}"
    if not np.isfinite(figures["half_width_m"]):
        return error
    covers = coverage_text(figures["coverage"], figures["coverage_least"])
    return f"{error}  {covers}  {FRACTION.number(figures['in_range'])}"


if __name__ == "__main__":
    raise SystemExit(main())
