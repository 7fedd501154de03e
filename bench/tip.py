"""The robot's tip predictor in its loop, with the rig behind the servos, on what no training saw.

1.3 kg, a link of the rig's variation, and motions that nothing was trained on (triangle, steps), or
one that was trained on with other payloads and links (multisine); a multisine that is stopped on
its way; a free decay. Beside the bundle's predictor: the paper's polynomial and the observer's tip.
Another rig needs a bundle that was trained on trials of it. Writes OUT/tip_DOFdof.json.

    python -m bench.tip build/bundle_1dof --out build/bench
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_py.bus.servo_models import model_named
from firmware_py.core.console import DONE, Progress
from firmware_py.core.motion import Motion, MotionConfig
from firmware_py.inference.bundle import POLYNOMIAL, PREDICTOR, ModelBundle
from firmware_py.inference.predictor import OnnxPredictor
from firmware_py.safety.states import SafetyState
from hil.emulator.physics import RigSource
from hil.sil import SilOptions, run_sil
from hil.sil.tip_errors import programme_part, true_tip_m
from models.plant.plant import read_plant
from models.plant.simulation.runner import CompiledModel
from models.plant.step_model import names
from models.predictor.validation import axis_coverage
from models.rig.drawn import rig_named
from models.rig.protocol import TrialCase, run_trial_cases
from models.trials.files import read_trial

Array = NDArray[np.float64]
PAYLOAD_KG: Final = 1.3
SEED: Final = 3
SERVO: Final = "H54-200-S500-R"
SECONDS: Final = {"multisine": 20.0, "triangle": 20.0, "steps": 37.0}
STOPPED_S: Final = 8.0
"""Time at which a multisine is stopped on its way."""
PARTS: Final = ("all", "rest", "motion", "glide", "stop", "free decay")


@dataclass(frozen=True)
class TipRun:
    """What the robot measured in a run, and the true tip: NaN where a tick had no fresh data."""

    step_s: float
    angle_rad: Array
    current_a: Array
    tip_m: Array
    part: NDArray[np.str_]


class Answer(NamedTuple):
    """Tip, half width and range of each row of a run; the observer's own tip has no interval."""

    tip_m: Array
    half_width_m: Array
    in_range: NDArray[np.bool_]


def run_behind_servos(bundle: ModelBundle, motion: str, seconds: float, rig: str) -> TipRun:
    """Run the robot's loop with the rig behind the servos on the virtual line, then stop it."""
    with tempfile.TemporaryDirectory(prefix="dropstitch-tip-") as scratch:
        options = SilOptions(
            bundle=bundle, model=model_named(SERVO), out=Path(scratch),
            rig=RigSource({}, SEED, rig), line="virtual", seconds=seconds,
            payload_kg=PAYLOAD_KG, motion=MotionConfig().with_motion(motion), seed=SEED,
        )  # fmt: skip
        result = run_sil(options)
    records, joints = result.records, range(1, bundle.manifest.dof + 1)
    stopping = records["state"] >= SafetyState.STOPPING
    return TipRun(
        bundle.manifest.period_s,
        np.column_stack([records[f"angle_{j}_rad"] for j in joints]),
        np.column_stack([records[f"current_{j}_a"] for j in joints]),
        true_tip_m(records, result.outcome.truth),
        np.where(stopping, "stop", programme_part(records["time_s"], options.programme_s)),
    )  # fmt: skip


def run_free_decay(dof: int, rig: str) -> TipRun:
    """Step a leaning link back on the rig and let it swing: goals that the loop's limits refuse."""
    case = TrialCase(Motion("decay", dof=dof), PAYLOAD_KG, trial=1, seed=SEED)
    with tempfile.TemporaryDirectory(prefix="dropstitch-tip-") as scratch:
        path, *_ = run_trial_cases([case], rig_named(rig), Path(scratch), 1, lambda _: None)
        trial = read_trial(path)
    step_rad = np.abs(np.diff(trial.goal_rad, axis=0, prepend=0.0)).max(axis=1)
    moving = np.arange(len(trial)) >= trial.meta.rest_samples
    part = np.where(moving, np.where(step_rad < 1e-6, "free decay", "motion"), "rest")
    return TipRun(trial.step_s, trial.angle_rad, trial.current_a, trial.tip_m, part)


class Contenders:
    """The predictors of a bundle, and its observer."""

    def __init__(self, bundle: Path, dof: int) -> None:
        self._observer = CompiledModel(
            read_plant(bundle / "plant.json").step_model(dof, "observer")
        )
        self._graphs = {
            "deployed": OnnxPredictor(bundle / PREDICTOR, dof),
            "paper's polynomial": OnnxPredictor(bundle / POLYNOMIAL, dof),
        }

    def answers(self, run: TipRun) -> dict[str, Answer]:
        """Answer of every contender to a run."""
        measured = np.column_stack([run.angle_rad, run.current_a])
        y = self._observer.simulate(measured, run.step_s)[1:]
        signals = dict(zip(names(self._observer.model.outputs), y.T, strict=True))
        tips = {}
        for name, graph in self._graphs.items():
            rows = np.array([signals[signal] for signal in graph.wanted]).reshape(-1, len(y)).T
            columns = zip(run.angle_rad, run.current_a, signals["di"], rows, strict=True)
            with_payload = [graph.predict(a, i, float(di), row) for a, i, di, row in columns]
            tips[name] = Answer(
                np.array([t.tip_m for t in with_payload]),
                np.array([t.half_width_m for t in with_payload]),
                np.array([t.in_range for t in with_payload]),
            )  # fmt: skip
        tip_m = np.column_stack([signals[f"tip_{axis}_m"] for axis in "xyz"])
        tips["observer's tip"] = Answer(
            tip_m, np.full_like(tip_m, np.nan), np.ones(len(tip_m), dtype=bool)
        )
        return tips


def figures(run: TipRun, answer: Answer) -> dict[str, dict[str, float]]:
    """Error and coverage of an answer by part of the run.

    Coverage is counted on the axes along which the tip moves: mean over them, and the worst.
    """
    result = {}
    known = np.isfinite(run.tip_m).all(axis=1)
    error_m = run.tip_m - answer.tip_m
    distance_m = np.linalg.norm(error_m, axis=1)
    inside = np.abs(error_m) <= answer.half_width_m
    for part in PARTS:
        rows = known & ((run.part == part) | (part == "all"))
        if not rows.any():
            continue
        covered = axis_coverage(inside[rows], run.angle_rad.shape[1])
        result[part] = {
            "rows": int(rows.sum()),
            "mean_m": float(distance_m[rows].mean()),
            "max_m": float(distance_m[rows].max()),
            "coverage": covered.mean,
            "coverage_least": covered.least,
            "in_range": float(answer.in_range[rows].mean()),
        }
    return result


def measure(bundle: Path, motions: Sequence[str], rig: str) -> dict[str, Any]:
    """Figures by run, contender and part."""
    loaded = ModelBundle.load(bundle)
    dof = loaded.manifest.dof
    contenders = Contenders(bundle, dof)
    progress, document = Progress(f"tip {dof}DOF", len(motions)), {}
    for motion in motions:
        if motion == "decay":
            run = run_free_decay(dof, rig)
        elif motion == "stopped":
            run = run_behind_servos(loaded, "multisine", STOPPED_S, rig)
        else:
            run = run_behind_servos(loaded, motion, SECONDS[motion], rig)
        document[motion] = {
            name: figures(run, answer) for name, answer in contenders.answers(run).items()
        }
        progress.step(motion)
    return document


def main(argv: Sequence[str] | None = None) -> int:
    """Run, print a table, write the figures."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.tip", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    motions = [*SECONDS, "stopped", "decay"]
    parser.add_argument("bundle", type=Path, help="complete bundle with a chosen predictor")
    parser.add_argument("--out", type=Path, default=Path("build/bench"), help="build/bench")
    parser.add_argument("--rig", default="default", help="structure behind the servos (default)")
    parser.add_argument("--motions", nargs="+", default=motions, choices=motions)
    args = parser.parse_args(argv)
    document = measure(args.bundle, args.motions, args.rig)
    print(f"{'':50}{'mean, mm':>10}{'largest':>9}{'covers, %':>11}{'in range, %':>13}")
    for run, by_contender in document.items():
        for name, by_part in by_contender.items():
            row = by_part["all"]
            print(
                f"{f'{run}: {name}':50}{1e3 * row['mean_m']:10.2f}{1e3 * row['max_m']:9.1f}"
                f"{100 * row['coverage']:11.1f}{100 * row['in_range']:13.1f}"
            )
    args.out.mkdir(parents=True, exist_ok=True)
    path = args.out / f"tip_{ModelBundle.load(args.bundle).manifest.dof}dof.json"
    path.write_text(json.dumps(document, indent=1), encoding="utf-8")
    return DONE


if __name__ == "__main__":
    raise SystemExit(main())
