"""Run `make demo` or `make study` stage by stage, one line each.

A stage is some targets of the Makefile, made two at a time. Its output goes to a log file, which is
printed if the stage fails. The commands themselves are in build/commands.log, and in the report.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[1]
BUILD = ROOT / "build"


class Stage(NamedTuple):
    """Part of a demo."""

    words: str
    targets: str
    result: Callable[[], str]  # The figure that matters, from the files of the stage


# --- results ------------------------------------------------------------------------------------


def read(path: str) -> Any:
    return json.loads((BUILD / path).read_text(encoding="utf-8"))


def mm(length_m: float) -> str:
    return f"{1e3 * length_m:.1f} mm"


def trial_count(*directories: str) -> str:
    return f"{sum(len(list((BUILD / d).glob('*.csv'))) for d in directories)} trials"


def plant_error(path: str) -> str:
    two = read(path)["provenance"]["held_out"]["dof"]["2"]
    tip, rigid = mm(two["tip_rms_m"]), mm(two["rigid_tip_rms_m"])
    return f"RMS tip error {tip}; of a rigid link {rigid}"


def predictor_error(bundle: str, test: str) -> str:
    document = read(f"{bundle}/predictors.json")
    score = document["candidates"][document["chosen"]]["tests"][test]["all"]
    return f"mean tip error {mm(score['mean_m'])}, without a camera"


def unseen_error() -> str:
    evaluation = read("study/evaluate_unseen_20deg.json")
    return f"RMS tip error {mm(evaluation['tip_rms_m'])} at the smaller amplitude"


def fmu_checks() -> str:
    checks = [c for dof in (1, 2) for c in read(f"check_twin_{dof}dof.json")["checks"]]
    return f"{sum(c['passed'] for c in checks)} of {len(checks)} checks passed"


def loop_error(*runs: str) -> str:
    errors = [read(f"{run}/timing.json")["prediction_error"] for run in runs]
    worst_m = max(error["mean_euclidean_distance_m"] for error in errors)
    return f"mean tip error {mm(worst_m)} against the twin"


def timing_verdict(run: str) -> str:
    timing = read(f"{run}/timing.json")
    p99_ms = 1e-6 * timing["own_cost"]["p99_ns"]
    reason = timing["reason"].partition(";")[0]
    return f"{timing['verdict']}: {reason}; {p99_ms:.1f} ms of 17 ms used"


def page_size(page: str) -> str:
    return f"{(BUILD / page).stat().st_size / 1e6:.1f} MB"


# --- stages -------------------------------------------------------------------------------------

DEMO = (
    Stage(
        "simulate trials of a soft link on one servo and on two",
        "build/trials/.done build/unseen_multisine/.done",
        lambda: trial_count("trials", "unseen_multisine"),
    ),
    Stage(
        "identify the plant: stiffness, damping, friction, delays",
        "build/plant.json",
        lambda: plant_error("plant.json"),
    ),
    Stage(
        "train the predictors of the tip",
        "build/bundle_2dof/predictor.onnx build/bundle_1dof/predictor.onnx",
        lambda: predictor_error("bundle_2dof", "trial_2"),
    ),
    Stage(
        "build observers and digital twins as FMUs, and check them",
        "build/check_twin_2dof.json build/check_twin_1dof.json",
        fmu_checks,
    ),
    Stage(
        "run the robot's loop for a minute of simulated time",
        "build/sil_2dof/timing.json build/sil_1dof/timing.json",
        lambda: loop_error("sil_1dof", "sil_2dof"),
    ),
    Stage(
        "run the loop in real time against emulated servos",
        "build/sil/timing.json",
        lambda: timing_verdict("sil"),
    ),
    Stage("write the report", "build/report.html", lambda: page_size("report.html")),
)

STUDY = (
    Stage(
        "simulate five payloads, two phases and a smaller amplitude",
        "build/study/trials/.done build/study/unseen_20deg/.done build/unseen_multisine/.done",
        lambda: trial_count("study/trials", "study/unseen_20deg", "unseen_multisine"),
    ),
    Stage(
        "identify the plant",
        "build/study/plant.json",
        lambda: plant_error("study/plant.json"),
    ),
    Stage(
        "compare the predictors, and repeat the paper's study",
        "build/study/bundle_2dof/observer.fmu build/study/bundle_1dof/observer.fmu",
        lambda: predictor_error("study/bundle_2dof", "unseen_20deg"),
    ),
    Stage(
        "repeat the study for each phase, and evaluate the plant",
        "build/study/study_2dof_phase0/study.json build/study/study_2dof_phase90/study.json "
        "build/study/evaluate_unseen_20deg.json build/study/evaluate_unseen_multisine.json",
        unseen_error,
    ),
    Stage(
        "run the loop with two joints, at both phases",
        "build/study/sil_2dof_phase0/timing.json build/study/sil_2dof_phase90/timing.json",
        lambda: loop_error("study/sil_2dof_phase0", "study/sil_2dof_phase90"),
    ),
    Stage(
        "run the loop in real time with two joints",
        "build/study/sil_socket_2dof/timing.json",
        lambda: timing_verdict("study/sil_socket_2dof"),
    ),
    Stage("write the report", "build/study/report.html", lambda: page_size("study/report.html")),
)


def run(name: str, stages: tuple[Stage, ...]) -> int:
    """Make the targets of each stage; stop at the first that fails."""
    logs = BUILD / "logs"
    logs.mkdir(parents=True, exist_ok=True)
    environment = {k: v for k, v in os.environ.items() if k not in ("MAKEFLAGS", "MAKELEVEL")}
    for number, stage in enumerate(stages, start=1):
        print(f"[{number}/{len(stages)}] {stage.words} ... ", end="", flush=True)
        start_s = time.monotonic()
        log = logs / f"{name}_{number}.log"
        with log.open("w", encoding="utf-8") as output:
            made = subprocess.run(
                ["make", "--no-print-directory", "--jobs=2", *stage.targets.split()],
                cwd=ROOT, env=environment, stdout=output, stderr=subprocess.STDOUT, check=False,
            )  # fmt: skip
        if made.returncode:
            print(f"failed\n\n{log.read_text(encoding='utf-8', errors='replace')}")
            return made.returncode
        print(f"{stage.result()} ({time.monotonic() - start_s:.0f} s)", flush=True)
    return 0


if __name__ == "__main__":
    name = sys.argv[1]
    sys.exit(run(name, {"demo": DEMO, "study": STUDY}[name]))
