"""Table of plans for the tip on the rig, by the robot's loop: writes OUT/PART.json.

    python -m bench.plans speeds --build build --out build/bench_plans

Plans are open loop. `speeds`: circle and figure eight of 0.3 m in 8 and 4 s, rigid kinematics,
payload known, and payload estimated in the second run. `learning`: five runs with motion capture on
rigs with a fifth more stiffness or damping than the plant believes, 1.8 kg. `moves`: 25° with 2 kg,
from rest to rest: as fast as the limits permit with a rigid link, ZVD shaping, the shortest
inverted move.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from bench.plans.rig_runs import SEED, by_mocap, larger_rig, run_on_rig
from firmware_py.config import UNWATCHED_RATE_RAD_S
from firmware_py.console import DONE, Progress
from firmware_py.goals.tip_plan import TipPlan
from firmware_py.inference.manifest import read_bundle_files
from firmware_py.safety.limits import Limits
from models.plan.path_shapes import PathOptions, built_in_path
from models.plan.plan_learning import improve_plan
from models.plan.planning import Method, PlanRequest, plan_path, shortest_move_s
from models.plan.recorded_plan_run import read_plan_run
from models.plant.plant import Plant, read_plant
from models.trials.trial_files import write_trial

LIMITS: Final = Limits(rate_rad_s=UNWATCHED_RATE_RAD_S)
PAYLOADS_KG: Final = (0.5, 1.0, 1.5, 2.0)
RUN_KG: Final = (0.7, 1.8)
LEARNING_RUNS: Final = 5
MOVE: Final = PathOptions(size_m=0.2135, centre_m=(0.2135,), seconds=12.0)
"""From upright to 25°: 1.01 m times the sine, and back."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a part, print and write its figures."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.plans", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("part", choices=("speeds", "learning", "moves"))
    parser.add_argument("--build", type=Path, default=Path("build"), help="plant and bundles")
    parser.add_argument("--out", type=Path, default=Path("build/bench_plans"))
    args = parser.parse_args(argv)
    part = {"speeds": speeds, "learning": learning, "moves": moves}[args.part]
    document = part(args.build)
    args.out.mkdir(parents=True, exist_ok=True)
    text = json.dumps(document, indent=1) + "\n"
    (args.out / f"{args.part}.json").write_text(text, encoding="utf-8")
    print(text, end="")
    return DONE


def _plan(
    build: Path, dof: int, name: str, options: PathOptions, method: Method = "inverse",
    payloads_kg: Sequence[float] = PAYLOADS_KG, *, fastest: bool = False,
) -> TipPlan:  # fmt: skip
    files = read_bundle_files(_bundle(build, dof))
    period_s = files.manifest.period_s
    request = PlanRequest(
        _plant(build), dof, period_s, LIMITS, payloads_kg, files.manifest_sha256, method, False
    )
    if fastest:
        move_s = shortest_move_s(
            lambda s: built_in_path(name, dof, period_s, _with_move(options, s)), request
        )
        options = _with_move(options, move_s)
    return plan_path(built_in_path(name, dof, period_s, options), request)


def _with_move(options: PathOptions, move_s: float) -> PathOptions:
    return PathOptions(**(vars(options) | {"move_s": move_s}))


def _bundle(build: Path, dof: int) -> Path:
    return build / f"bundle_{dof}dof"


def _plant(build: Path) -> Plant:
    return read_plant(build / "plant.json")


def speeds(build: Path) -> dict[str, Any]:
    """RMS errors of circle and figure eight by speed and payload, and their least ratios.

    Parameters
    ----------
    build : Path
        Directory with plant and bundles.
    """
    cases, bundle = [], _bundle(build, 2)
    progress = Progress("bench.plans speeds", 4)
    for name in ("circle", "figure_eight"):
        for seconds in (8.0, 4.0):
            options = PathOptions(seconds=seconds)
            inverse, rigid = (_plan(build, 2, name, options, m) for m in ("inverse", "rigid"))
            for kg in RUN_KG:
                own = {
                    "rigid": run_on_rig(rigid, bundle, kg).rms_m,
                    "known": run_on_rig(inverse, bundle, kg).rms_m,
                    "unknown": run_on_rig(inverse, bundle, kg, known=False, runs=2).rms_m,
                }
                cases.append({"path": name, "seconds": seconds, "payload_kg": kg, **own})
            progress.step(f"{name} {seconds:g} s")
    times = {
        f"{k}_times": min(case["rigid"] / case[k] for case in cases) for k in ("known", "unknown")
    }
    return {"cases": cases} | times


def learning(build: Path) -> dict[str, Any]:
    """RMS errors before learning and after each run, and the largest after the last.

    Parameters
    ----------
    build : Path
        Directory with plant and bundles.
    """
    plant, cases = _plant(build), []
    progress = Progress("bench.plans learning", 4)
    for dof, name, options in (
        (1, "line", PathOptions(size_m=0.45, seconds=4.352, turns=2)),
        (2, "circle", PathOptions(size_m=0.45, seconds=6.0)),
    ):
        first = _plan(build, dof, name, options)
        for what in ("stiffness", "damping"):
            plan, errors, rng = first, [], np.random.default_rng(1)
            with tempfile.TemporaryDirectory() as scratch:
                rig = str(larger_rig(what, Path(scratch)))
                for number in range(LEARNING_RUNS + 1):
                    run = run_on_rig(plan, _bundle(build, dof), 1.8, rig=rig, seed=SEED + number)
                    errors.append(run.rms_m)
                    if number < LEARNING_RUNS:
                        path = write_trial(by_mocap(run, rng), Path(scratch) / str(number))
                        plan = improve_plan(plan, read_plan_run(path, plan), plant, LIMITS).plan
            cases.append({"dof": dof, "more": what, "rms_m": errors})
            progress.step(f"{dof}DOF, {what}")
    last = {
        f"last_{dof}dof_m": max(c["rms_m"][-1] for c in cases if c["dof"] == dof) for dof in (1, 2)
    }
    return {"cases": cases} | last


def moves(build: Path) -> dict[str, Any]:
    """Settling time and swing of the three moves, and their ratios to the rigid one.

    Parameters
    ----------
    build : Path
        Directory with plant and bundles.
    """
    found: dict[str, Any] = {}
    for method in ("rigid", "zvd", "inverse"):
        plan = _plan(build, 1, "point_to_point", MOVE, method, (2.0,), fastest=method == "inverse")
        own = run_on_rig(plan, _bundle(build, 1), 2.0).moves
        found[method] = {
            "settling_s": max(m.settling_s for m in own),
            "swing_m": max(m.swing_m for m in own),
        }
    inverse, rigid = found["inverse"], found["rigid"]
    found["settling_ratio"] = inverse["settling_s"] / rigid["settling_s"]
    found["swing_ratio"] = inverse["swing_m"] / rigid["swing_m"]
    return found


if __name__ == "__main__":
    raise SystemExit(main())
