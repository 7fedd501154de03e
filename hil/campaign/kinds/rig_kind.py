"""Kind of cases: one trial of the rig, its figures, and a plant's errors on it."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta

from firmware_py.core.errors import InputError
from hil.campaign.kinds.case_kind import CaseKind, MotionOptions, Seed, check_effects, load_once


class RigOptions(MotionOptions, frozen=True, kw_only=True):
    """Options of a trial."""

    rig: str = "default"  # Structure, `drawn_K`, file that changes a structure, or link
    # Strength of each effect added to the rig
    effects: dict[str, float] = msgspec.field(default_factory=dict)
    # Factors on parameters of the rig
    factors: dict[str, float] = msgspec.field(default_factory=dict)
    dof: Literal[1, 2] = 1
    payload_kg: Annotated[float, Meta(ge=0, le=10)] = 0.0
    pressure_pa: float | None = None  # By default that of the link, or of the study
    trial: Annotated[int, Meta(ge=0, le=1000)] = 1  # Number of the repetition
    seed: Seed = 0  # Of variation and noise
    plant: str | None = None  # Plant whose errors on the trial are computed

    def __post_init__(self) -> None:
        check_effects(self.effects)

    def files(self) -> dict[str, str]:
        plant = {} if self.plant is None else {"plant": self.plant}
        return super().files() | rig_file(self.rig) | plant


def run_trial(options: RigOptions, scratch: Path) -> dict[str, Any]:
    from firmware_py.link.link_description import STUDY_LINK
    from models.plant.identification.evaluation import compare_with_trials
    from models.plant.plant import read_plant  # loads CasADi
    from models.rig.protocol import TrialCase, run_case  # slow to import
    from models.shared.kinematics import rigid_tip_m
    from models.trials.deformation import deformation_index

    rig = changed_rig(options.rig, options.factors, options.effects)
    link = rig.link or STUDY_LINK
    trial = run_case(
        rig,
        TrialCase(
            options.motion_config().motion(options.dof), options.payload_kg, options.trial,
            options.seed, link.pressure_pa if options.pressure_pa is None else options.pressure_pa,
            link.gravity.unit,
        ),
    )  # fmt: skip
    columns = {n: c for n, c in trial.columns.items() if not n.startswith("m")}
    columns["di"] = deformation_index(trial)
    rigid_m = rigid_tip_m(trial.angle_rad, trial.meta.base_offset_m, trial.meta.link_length_m)
    result = {
        "name": trial.name,
        "rows": len(trial),
        "rms": {n: rms(c) for n, c in columns.items() if n != "time_s"},
        "largest": {n: float(np.nanmax(np.abs(c))) for n, c in columns.items()},
        "rigid_tip_rms_m": rms(np.linalg.norm(rigid_m - trial.tip_m, axis=1)),
        "trial_sha256": columns_sha256(trial.columns),
    }
    if options.plant is not None:
        plant = load_once(read_plant, Path(options.plant))
        comparison = compare_with_trials(plant, [trial])[0]
        result["plant_rms"] = {n: rms(comparison.error(n)) for n in comparison.simulated}
    return result


KIND = CaseKind(
    name="rig",
    options=RigOptions,
    run=run_trial,
    sources=("firmware_py", "models", "hil/campaign/kinds"),
    figures={
        "rigid_tip_rms_m": "tip off a rigid link's, RMS",
        "largest.di": "largest DI",
        "rms.current_1_a": "current of servo 1, RMS",
        "plant_rms.tip_x_m": "error of the plant, tip x, RMS",
    },
)


def rig_file(name: str) -> dict[str, str]:
    """Field `rig` if it names a file instead of a structure."""
    return {"rig": name} if Path(name).is_file() else {}


def changed_rig(name: str, factors: dict[str, float], effects: dict[str, float]) -> Any:
    from models.rig.drawn import rig_named

    rig = rig_named(name)
    if unknown := sorted(factors.keys() - set(rig)):
        raise InputError(f"factors.{unknown[0]}", "is no parameter of the rig", "see rig.toml")
    return rig.changed(**{n: factor * rig[n] for n, factor in factors.items()}).hide(effects)


def rms(values: Any) -> float:
    """Root mean square of the values that are not NaN."""
    return float(np.sqrt(np.nanmean(np.square(values))))


def columns_sha256(columns: Mapping[str, Any]) -> str:
    digest = hashlib.sha256()
    for name, column in sorted(columns.items()):
        digest.update(name.encode() + np.ascontiguousarray(column).tobytes())
    return digest.hexdigest()
