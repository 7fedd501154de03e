"""Runs of plans by the robot's loop, with a rig behind the emulated servos."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.bus.servo_models import model_named
from firmware_py.goals.tip_plan import TipPlan
from firmware_py.inference.bundle import ModelBundle
from hil.emulator.physics import RigSource
from hil.sil import SilOptions, run_sil
from hil.sil.move_figures import move_figures
from hil.sil.path_error import path_errors, tip_of_runs_m
from hil.sil.sil_trial import as_trial
from hil.timing.timing_document import MoveFigures
from models.rig.rig_parameters import read_rig
from models.trials.trial import Trial

Array = NDArray[np.float64]
SERVO: Final = "H54-200-S500-R(A)"
"""With a bus watchdog, so that the full limit of the rate holds."""
SEED: Final = 5
"""First seed of the rig's variation; no plant was identified on it."""
LARGER: Final = 1.2
"""Stiffness or damping of the rig over that which the plant believes."""
RIGS: Final = {
    "stiffness": ("stiffness.root_nm_rad", "stiffness.bending_n_m2", "stiffness.wall_shear_n"),
    "damping": ("stiffness.damping_s",),
}


@dataclass(frozen=True)
class RigRun:
    """Last run of a plan."""

    rms_m: float  # Distance of the true tip from the path, rest and ways included
    moves: tuple[MoveFigures, ...]  # Moves from rest to rest
    trial: Trial  # With the true tip
    tip_m: Array  # (n, dof), true tip at each row of the plan


def run_on_rig(
    plan: TipPlan, bundle: Path, payload_kg: float, *,
    rig: str = "default", seed: int = SEED, known: bool = True, runs: int = 1,
    open_loop: bool = False,
) -> RigRun:  # fmt: skip
    """Run a plan; the last of its runs counts."""
    with tempfile.TemporaryDirectory(prefix="dropstitch-plans-") as scratch:
        options = SilOptions(
            bundle=ModelBundle.load(bundle), model=model_named(SERVO), out=Path(scratch),
            rig=RigSource({}, seed, rig), line="virtual", seconds=runs * plan.duration_s,
            payload_kg=payload_kg, payload_known=known, plan=plan, seed=seed,
            open_loop=open_loop,
        )  # fmt: skip
        result = run_sil(options)
        tip = tip_of_runs_m(result.records, result.outcome.truth, plan)
        errors = path_errors(result.records, result.outcome.truth, plan)
        if not errors:
            raise RuntimeError(f"the plan was not run to its end: {result.summary.reason}")
        moves = move_figures(tip[-1], plan)
        return RigRun(errors[-1].rms_m, moves, as_trial(result, options), tip[-1])


def larger_rig(what: str, directory: Path) -> Path:
    """Write a rig whose stiffness or damping is larger than that of the default one."""
    values = read_rig("default")
    units = {
        "root_nm_rad": "N.m/rad",
        "bending_n_m2": "N.m2",
        "wall_shear_n": "N",
        "damping_s": "s",
    }
    lines = [f'summary = "more {what}"', 'purpose = "tuning"', "[structure]"]
    for name in RIGS[what]:
        unit = units[name.split(".")[1]]
        lines += [f"[{name}]", f"value = {LARGER * values[name]!r}", f'unit = "{unit}"']
        lines.append('source = "assumed: a fifth more than the plant believes"')
    path = directory / f"more_{what}.toml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def by_mocap(run: RigRun, rng: np.random.Generator) -> Trial:
    """Trial of a run with the noise of a motion capture and a shift of its frame."""
    rig = read_rig("default")
    # The tip is the mean of four markers.
    noise_m, shift_m = 0.5 * rig["sensor.marker_noise_m"], rig["variation.frame_shift_m"]
    columns = dict(run.trial.columns)
    for axis in "xyz":
        name = f"tip_{axis}_m"
        shift, noise = rng.standard_normal(), rng.standard_normal(len(run.trial))
        columns[name] = columns[name] + shift_m * shift + noise_m * noise
    return Trial(run.trial.name, run.trial.meta, columns)
