"""Runs behind the servos and free decays, as the robot's loop saw them beside the true tip."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.bus.servo_models import model_named
from firmware_py.inference.bundle import ModelBundle
from firmware_py.motion import Motion
from firmware_py.motion_config import MotionConfig
from firmware_py.safety.states import SafetyState
from hil.emulator.physics import RigSource
from hil.sil import SilOptions, run_sil
from hil.sil.prediction_error import programme_part, true_tip_m
from hil.sil.sil_options import programme_s
from models.rig.drawn_rig import rig_named
from models.rig.trial_case import TrialCase
from models.rig.trial_runner import run_trial_cases
from models.trials.trial_files import read_trial

Array = NDArray[np.float64]
PAYLOAD_KG: Final = 1.3
SEED: Final = 3
SERVO: Final = "H54-200-S500-R"
SECONDS: Final = {"multisine": 20.0, "triangle": 20.0, "steps": 37.0}
STOPPED_S: Final = 8.0
"""Time at which a multisine is stopped on its way."""


@dataclass(frozen=True)
class TipRun:
    """Run of the robot."""

    name: str
    step_s: float
    angle_rad: Array  # (n, dof)
    current_a: Array
    tip_m: Array  # (n, 3), true tip; NaN where the tick had no fresh data
    part: NDArray[np.str_]  # (n,), rest, motion, glide, stop or free decay

    @property
    def dof(self) -> int:
        """Number of joints."""
        return int(self.angle_rad.shape[1])


def run_behind_servos(
    bundle: ModelBundle,
    motion: str,
    seconds: float,
    hidden: Mapping[str, float] | None = None,
    rig: str = "default",
) -> TipRun:
    """Run the robot's loop with the rig behind the servos on the virtual line."""
    with tempfile.TemporaryDirectory(prefix="dropstitch-tip-") as scratch:
        options = SilOptions(
            bundle=bundle, model=model_named(SERVO), out=Path(scratch),
            rig=RigSource(dict(hidden or {}), SEED, rig), line="virtual", seconds=seconds,
            payload_kg=PAYLOAD_KG, motion=MotionConfig().with_motion(motion), seed=SEED,
        )  # fmt: skip
        result = run_sil(options)
    records, dof = result.records, bundle.manifest.dof
    stopping = records["state"] >= SafetyState.STOPPING
    part = np.where(stopping, "stop", programme_part(records["time_s"], programme_s(options)))
    return TipRun(
        motion, bundle.manifest.period_s,
        np.column_stack([records[f"angle_{j}_rad"] for j in range(1, dof + 1)]),
        np.column_stack([records[f"current_{j}_a"] for j in range(1, dof + 1)]),
        true_tip_m(records, result.outcome.truth), part,
    )  # fmt: skip


def run_free_decay(dof: int, rig: str = "default") -> TipRun:
    """Step a leaning link back on the rig and let it swing: goals that the loop's limits refuse."""
    case = TrialCase(Motion("decay", dof=dof), PAYLOAD_KG, trial=1, seed=SEED)
    with tempfile.TemporaryDirectory(prefix="dropstitch-tip-") as scratch:
        path, *_ = run_trial_cases([case], rig_named(rig), Path(scratch), 1, lambda _: None)
        trial = read_trial(path)
    goals = np.column_stack([trial.columns[f"goal_{j}_rad"] for j in range(1, dof + 1)])
    still = np.concatenate([[0.0], np.abs(np.diff(goals, axis=0)).max(axis=1)]) < 1e-6
    moving = np.arange(len(trial)) >= trial.meta.rest_samples
    part = np.where(moving, np.where(still, "free decay", "motion"), "rest")
    return TipRun("decay", trial.step_s, trial.angle_rad, trial.current_a, trial.tip_m, part)
