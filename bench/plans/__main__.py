"""Table of plans for the tip on the rig, by the robot's loop: writes OUT/PART.json.

    python -m bench.plans speeds --build build --out build/bench_plans

`speeds`: circle and figure eight of 0.5 m, the study's 30°, in 8 and 4 s, with feedback: rigid
kinematics, payload known, and payload estimated in the second run. `robust`: rigs with a fifth more
stiffness or damping than the plant believes, payload known and estimated, open loop and with
feedback, in the second run where the robot learns within it. `probed`: the same with feedback and a
probing motion before the first run, and on the rig that the plant was identified on. `learning`:
five runs with motion capture on these rigs, 1.8 kg, of plans with feedback, the default, and open
loop; then three runs on draws of the rig that learning did not see. `moves`: 25° with 2 kg, from
rest to rest: as fast as the limits permit with a rigid link, ZVD shaping, the shortest inverted
move. `text`: HELLO in 40 s with 1 kg and feedback; draws it to OUT/text.svg. `other_rig`:
`--rig NAME` behind plans from `--plant FILE`, identified on trials of it, open loop, payload known:
at once, and after one run, from which shape and timing of the goals were learned.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from bench.plans.rig_runs import SEED, by_mocap, larger_rig, run_on_rig
from bench.plans.text_picture import draw_text
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

LIMITS: Final = Limits()
MOVE_LIMITS: Final = Limits(rate_rad_s=UNWATCHED_RATE_RAD_S)
"""A rigid move with 2 kg at the full rate draws 8.4 A, beyond `limits.current_a`."""
PAYLOADS_KG: Final = (0.5, 1.0, 1.5, 2.0)
RUN_KG: Final = (0.7, 1.8)
LEARNING_RUNS: Final = 5
STUDY_M: Final = 0.5
"""Half extent of the study's motion, ±30° with 1.01 m."""
LINE: Final = ("line", PathOptions(size_m=0.45, seconds=4.352, turns=2))
CIRCLE: Final = ("circle", PathOptions(size_m=0.45, seconds=6.0))
PATHS: Final = {1: LINE, 2: CIRCLE}
"""Path by number of joints."""
FURTHER_DRAWS: Final = 3
"""Draws of the rig on which a plan is judged after learning."""
MOVE: Final = PathOptions(size_m=0.2135, centre_m=(0.2135,), seconds=12.0)
"""From upright to 25°: 1.01 m times the sine, and back."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a part, print and write its figures."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.plans", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("part", choices=PARTS)
    parser.add_argument("--build", type=Path, default=Path("build"), help="plant and bundles")
    parser.add_argument("--out", type=Path, default=Path("build/bench_plans"))
    parser.add_argument("--rig", default="test_a", help="rig of other_rig (test_a)")
    parser.add_argument("--plant", type=Path, help="plant of other_rig")
    args = parser.parse_args(argv)
    args.out.mkdir(parents=True, exist_ok=True)
    if args.part == "text":
        document = text(args.build, args.out / "text.svg")
    elif args.part == "other_rig":
        document = other_rig(args.build, args.rig, read_plant(args.plant))
    else:
        document = PARTS[args.part](args.build)
    said = json.dumps(document, indent=1) + "\n"
    (args.out / f"{args.part}.json").write_text(said, encoding="utf-8")
    print(said, end="")
    return DONE


def _plan(
    build: Path, dof: int, name: str, options: PathOptions, method: Method = "inverse",
    payloads_kg: Sequence[float] = PAYLOADS_KG, *, fastest: bool = False, feedback: bool = False,
    plant: Plant | None = None, limits: Limits = LIMITS, probe: bool = False,
) -> TipPlan:  # fmt: skip
    files = read_bundle_files(_bundle(build, dof))
    period_s = files.manifest.period_s
    request = PlanRequest(
        plant or _plant(build), dof, period_s, limits, payloads_kg, files.manifest_sha256, method,
        feedback, probe,
    )  # fmt: skip
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
    """RMS errors of circle and figure eight by speed and payload, and their least ratios."""
    cases, bundle = [], _bundle(build, 2)
    progress = Progress("bench.plans speeds", 4)
    for name in ("circle", "figure_eight"):
        for seconds in (8.0, 4.0):
            options = PathOptions(size_m=STUDY_M, seconds=seconds)
            inverse = _plan(build, 2, name, options, feedback=True)
            rigid = _plan(build, 2, name, options, "rigid")
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
    """RMS errors of each run, and after five of them over further draws of the rig."""
    cases = []
    progress = Progress("bench.plans learning", 8)
    for dof, (name, options) in PATHS.items():
        for feedback in (True, False):
            first = _plan(build, dof, name, options, feedback=feedback)
            for what in ("stiffness", "damping"):
                errors, expected = _learned(build, first, what)
                after = float(np.sqrt(np.mean(np.square(errors[LEARNING_RUNS:]))))
                cases.append({
                    "dof": dof, "feedback": feedback, "more": what, "rms_m": errors,
                    "expected_rms_m": expected, "after_m": after,
                })  # fmt: skip
                progress.step(f"{dof}DOF, {what}, {'feedback' if feedback else 'open loop'}")
    last = {f"last_{n}dof_m": max(c["after_m"] for c in cases if c["dof"] == n) for n in (1, 2)}
    return {"cases": cases} | last


def _learned(build: Path, plan: TipPlan, what: str) -> tuple[list[float], list[float | None]]:
    """RMS errors of all runs of a plan that learns from the first ones, and those expected."""
    plant, bundle, errors = _plant(build), _bundle(build, plan.dof), []
    rng = np.random.default_rng(1)
    with tempfile.TemporaryDirectory() as scratch:
        rig = str(larger_rig(what, Path(scratch)))
        for number in range(LEARNING_RUNS + FURTHER_DRAWS):
            run = run_on_rig(plan, bundle, 1.8, rig=rig, seed=SEED + number)
            errors.append(run.rms_m)
            if number < LEARNING_RUNS:
                path = write_trial(by_mocap(run, rng), Path(scratch) / str(number))
                plan = improve_plan(plan, read_plan_run(path, plan), plant, LIMITS).plan
    return errors, [own.expected_rms_m for own in plan.learned]


def moves(build: Path) -> dict[str, Any]:
    """Settling time and swing of the three moves, and their ratios to the rigid one."""
    found: dict[str, Any] = {}
    for method in ("rigid", "zvd", "inverse"):
        plan = _plan(
            build, 1, "point_to_point", MOVE, method, (2.0,), fastest=method == "inverse",
            limits=MOVE_LIMITS,
        )  # fmt: skip
        own = run_on_rig(plan, _bundle(build, 1), 2.0).moves
        found[method] = {
            "settling_s": max(m.settling_s for m in own),
            "swing_m": max(m.swing_m for m in own),
        }
    inverse, rigid = found["inverse"], found["rigid"]
    found["settling_ratio"] = inverse["settling_s"] / rigid["settling_s"]
    found["swing_ratio"] = inverse["swing_m"] / rigid["swing_m"]
    return found


def robust(build: Path) -> dict[str, Any]:
    """RMS errors on rigs that differ from the plant, and their least ratios by number of joints."""
    cases: list[dict[str, Any]] = []
    progress = Progress("bench.plans robust", 4)
    for dof, (name, options) in PATHS.items():
        bundle = _bundle(build, dof)
        inverse = _plan(build, dof, name, options, feedback=True)
        rigid = _plan(build, dof, name, options, "rigid")
        for what in ("stiffness", "damping"):
            with tempfile.TemporaryDirectory() as scratch:
                rig = str(larger_rig(what, Path(scratch)))
                for kg in RUN_KG:
                    own = {
                        "rigid": run_on_rig(rigid, bundle, kg, rig=rig).rms_m,
                        "open": run_on_rig(inverse, bundle, kg, rig=rig, open_loop=True).rms_m,
                        "feedback": run_on_rig(inverse, bundle, kg, rig=rig, runs=2).rms_m,
                        "open_unknown": run_on_rig(
                            inverse, bundle, kg, rig=rig, runs=2, known=False, open_loop=True
                        ).rms_m,
                        "feedback_unknown": run_on_rig(
                            inverse, bundle, kg, rig=rig, runs=2, known=False
                        ).rms_m,
                    }
                    cases.append({"dof": dof, "more": what, "payload_kg": kg, **own})
            progress.step(f"{dof}DOF, {what}")
    times = {
        f"{kind}_times_{n}dof": min(c["rigid"] / c[kind] for c in cases if c["dof"] == n)
        for kind in ("open", "feedback", "open_unknown", "feedback_unknown")
        for n in PATHS
    }
    return {"cases": cases} | times


def probed(build: Path) -> dict[str, Any]:
    """RMS errors of plans with a probing motion, on rigs as the plant and others; least ratios."""
    cases: list[dict[str, Any]] = []
    progress = Progress("bench.plans probed", 6)
    for dof, (name, options) in PATHS.items():
        bundle = _bundle(build, dof)
        inverse = _plan(build, dof, name, options, feedback=True, probe=True)
        rigid = _plan(build, dof, name, options, "rigid")
        for what in ("nothing", "stiffness", "damping"):
            with tempfile.TemporaryDirectory() as scratch:
                rig = "default" if what == "nothing" else str(larger_rig(what, Path(scratch)))
                for kg in RUN_KG:
                    own = {"rigid": run_on_rig(rigid, bundle, kg, rig=rig).rms_m}
                    for kind, known in (("known", True), ("unknown", False)):
                        own[kind] = run_on_rig(
                            inverse, bundle, kg, rig=rig, runs=2, known=known
                        ).rms_m
                    cases.append({"dof": dof, "more": what, "payload_kg": kg, **own})
            progress.step(f"{dof}DOF, {what}")
    times = {
        f"{kind}_times_{n}dof{'_same' if same else ''}": min(
            c["rigid"] / c[kind]
            for c in cases
            if c["dof"] == n and (c["more"] == "nothing") is same
        )
        for kind in ("known", "unknown")
        for n in PATHS
        for same in (False, True)
    }
    return {"cases": cases} | times


def text(build: Path, picture: Path) -> dict[str, Any]:
    """RMS error of a text that is written, and its picture."""
    options = PathOptions(size_m=0.45, seconds=40.0)
    plan = _plan(build, 2, "text:HELLO", options, payloads_kg=(1.0,), feedback=True)
    run = run_on_rig(plan, _bundle(build, 2), 1.0)
    draw_text(plan, run.tip_m, picture)
    strokes = np.concatenate([np.arange(a, b) for a, b in plan.drawn])
    error = np.linalg.norm(run.tip_m - plan.desired_tip_m(), axis=1)[strokes]
    return {
        "rms_m": run.rms_m,
        "strokes_rms_m": float(np.sqrt(np.nanmean(error**2))),
        "strokes_max_m": float(np.nanmax(error)),
    }


def other_rig(build: Path, rig: str, plant: Plant) -> dict[str, Any]:
    """RMS errors on a rig at once, and improved by a run, from which the timing is learned too.

    `build`: directory with a bundle, of which only the period counts.
    """
    name, options = LINE
    cases, bundle = [], _bundle(build, 1)
    inverse, rigid = (_plan(build, 1, name, options, m, plant=plant) for m in ("inverse", "rigid"))
    for kg in RUN_KG:
        straight, first = (run_on_rig(p, bundle, kg, rig=rig) for p in (rigid, inverse))
        with tempfile.TemporaryDirectory() as scratch:
            path = write_trial(by_mocap(first, np.random.default_rng(1)), Path(scratch))
            recorded = read_plan_run(path, inverse)
        improved = improve_plan(inverse, recorded, plant, LIMITS).plan
        second = run_on_rig(improved, bundle, kg, rig=rig, seed=SEED + 1)
        cases.append({
            "payload_kg": kg, "rigid": straight.rms_m, "at_once": first.rms_m,
            "goal_lead_s": improved.goal_lead_s, "improved": second.rms_m,
        })  # fmt: skip
    times = {f"{k}_times": min(c["rigid"] / c[k] for c in cases) for k in ("at_once", "improved")}
    return {"rig": rig, "cases": cases} | times


PARTS: Final[dict[str, Callable[..., dict[str, Any]]]] = {
    "speeds": speeds, "robust": robust, "probed": probed, "learning": learning, "moves": moves,
    "text": text, "other_rig": other_rig,
}  # fmt: skip


if __name__ == "__main__":
    raise SystemExit(main())
