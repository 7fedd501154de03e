"""Plans for the tip on the rig, by the robot's loop, beside goals of rigid kinematics.

A line (1DOF) or a circle (2DOF) of 0.45 m, with the plan's feedback: payload known, and estimated
in the second run. Behind the servos is the rig that the plant was identified on. Prints and writes
OUT/plans.json.

    python -m bench.plans --build build --out build/bench
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from firmware_py.bus.servo_models import model_named
from firmware_py.core.console import DONE, Progress
from firmware_py.goals.tip_plan import TipPlan
from firmware_py.inference.bundle import ModelBundle
from firmware_py.inference.manifest import read_bundle_files
from firmware_py.safety.limits import Limits
from hil.emulator.physics import RigSource
from hil.sil import SilOptions, run_sil
from hil.sil.tip_errors import path_errors, tip_of_runs_m
from models.plan.paths import PathOptions, built_in_path
from models.plan.plan import Method, PlanRequest, plan_path
from models.plant.plant import read_plant

SERVO: Final = "H54-200-S500-R(A)"
"""With a bus watchdog, so that the full limit of the rate holds."""
SEED: Final = 5
"""Of the rig's variation; no plant was identified on it."""
PLAN_KG: Final = (0.5, 1.0, 1.5, 2.0)
"""Payloads that a plan is made for."""
RUN_KG: Final = (0.7, 1.8)
PATHS: Final = {
    1: ("line", PathOptions(size_m=0.45, seconds=4.352, turns=2)),
    2: ("circle", PathOptions(size_m=0.45, seconds=6.0)),
}
"""Path by number of joints."""


def plan(build: Path, dof: int, method: Method) -> TipPlan:
    """Plan of the path of a number of joints."""
    files = read_bundle_files(build / f"bundle_{dof}dof")
    name, options = PATHS[dof]
    period_s = files.manifest.period_s
    request = PlanRequest(
        read_plant(build / "plant.json"), dof, period_s, Limits(), PLAN_KG,
        files.manifest_sha256, method, method == "inverse", False,
    )  # fmt: skip
    return plan_path(built_in_path(name, dof, period_s, options), request)


def rms_m(plan: TipPlan, bundle: ModelBundle, payload_kg: float, known: bool, runs: int) -> float:
    """Distance of the true tip from the path in the last run, rest and ways included."""
    with tempfile.TemporaryDirectory(prefix="dropstitch-plans-") as scratch:
        options = SilOptions(
            bundle=bundle, model=model_named(SERVO), out=Path(scratch),
            rig=RigSource({}, SEED, "default"), line="virtual", seconds=runs * plan.duration_s,
            payload_kg=payload_kg, payload_known=known, plan=plan, seed=SEED,
        )  # fmt: skip
        result = run_sil(options)
    errors = path_errors(tip_of_runs_m(result.records, result.outcome.truth, plan), plan)
    if not errors:
        raise RuntimeError(f"the plan was not run to its end: {result.summary.reason}")
    return errors[-1].rms_m


def measure(build: Path, joints: Sequence[int]) -> list[dict[str, Any]]:
    """RMS distance from the path by number of joints and payload."""
    cases: list[dict[str, Any]] = []
    progress = Progress("plans", len(joints) * len(RUN_KG))
    for dof in joints:
        bundle = ModelBundle.load(build / f"bundle_{dof}dof")
        rigid, inverse = plan(build, dof, "rigid"), plan(build, dof, "inverse")
        for kg in RUN_KG:
            cases.append({
                "dof": dof, "payload_kg": kg,
                "rigid_m": rms_m(rigid, bundle, kg, True, 1),
                "known_m": rms_m(inverse, bundle, kg, True, 1),
                "unknown_m": rms_m(inverse, bundle, kg, False, 2),
            })  # fmt: skip
            progress.step(f"{dof}DOF, {kg:g} kg")
    return cases


def main(argv: Sequence[str] | None = None) -> int:
    """Run, print and write the figures."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.plans", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("--build", type=Path, default=Path("build"), help="plant and bundles")
    parser.add_argument("--out", type=Path, default=Path("build/bench"))
    parser.add_argument("--dof", type=int, nargs="+", choices=(1, 2), default=[1, 2])
    args = parser.parse_args(argv)
    text = json.dumps(measure(args.build, args.dof), indent=1) + "\n"
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "plans.json").write_text(text, encoding="utf-8")
    print(text, end="")
    return DONE


if __name__ == "__main__":
    raise SystemExit(main())
