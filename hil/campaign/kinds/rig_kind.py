"""Kind of cases: one trial of the rig, its figures, and a plant's errors on it."""

from __future__ import annotations

import functools
import hashlib
from pathlib import Path
from typing import Any, ClassVar, Literal

import msgspec

from firmware_py.core.errors import InputError
from firmware_py.core.motion import KINDS as MOTIONS
from firmware_py.core.motion import STUDY_AMPLITUDE_RAD, STUDY_PERIOD_S
from hil.campaign.kinds.case_kind import CaseConfig, CaseContext, CaseKind
from hil.campaign.kinds.config_checks import check_effects_known, check_ranges


class RigConfig(CaseConfig, frozen=True, kw_only=True):
    """Configuration of a trial."""

    rig: str = "default"  # Structure, `drawn_K`, file that changes a structure, or link
    # Strength of each effect added to the rig
    effects: dict[str, float] = msgspec.field(default_factory=dict)
    # Factors on parameters of the rig
    factors: dict[str, float] = msgspec.field(default_factory=dict)
    dof: Literal[1, 2] = 1
    payload_kg: float = 0.0
    pressure_pa: float | None = None  # By default that of the link, or of the study
    motion: str = "sinusoid"  # Kind of motion, or a motion file
    amplitude_rad: float = STUDY_AMPLITUDE_RAD
    period_s: float = STUDY_PERIOD_S
    phase_2_rad: float = 0.0
    trial: int = 1  # Number of the repetition
    seed: int = 0  # Seed of variation and noise
    plant: str | None = None  # Plant whose errors on the trial are computed


class RigKind(CaseKind[RigConfig]):
    """Trials of the rig."""

    name: ClassVar[str] = "rig"
    config: ClassVar[type[RigConfig]] = RigConfig
    rooms: ClassVar[tuple[str, ...]] = ("firmware_py", "models", "hil/campaign/kinds")
    figures: ClassVar = {
        "rigid_tip_rms_m": "tip off a rigid link's, RMS",
        "largest.di": "largest DI",
        "rms.current_1_a": "current of servo 1, RMS",
        "plant_rms.tip_x_m": "error of the plant, tip x, RMS",
    }

    def files(self, config: RigConfig) -> dict[str, str]:
        found = {} if config.plant is None else {"plant": config.plant}
        if Path(config.rig).is_file():
            found["rig"] = config.rig
        if config.motion not in MOTIONS:
            found["motion"] = config.motion
        return found

    def check(self, config: RigConfig) -> None:
        check_effects_known(config.effects)
        check_ranges(
            config, payload_kg=(0.0, 10.0), period_s=(0.1, 1e4), seed=(0, 2**32 - 1),
            trial=(0, 1000),
        )  # fmt: skip

    def run(self, config: RigConfig, context: CaseContext) -> dict[str, Any]:
        import numpy as np

        from firmware_py.core.motion import MotionConfig
        from firmware_py.link.link_description import STUDY_LINK
        from models.plant.identification.evaluation import compare_with_trials
        from models.rig.protocol import TrialCase, run_case  # slow to import
        from models.shared.kinematics import rigid_tip_m
        from models.trials.deformation import deformation_index

        rig = changed_rig(config.rig, config.factors).hide(config.effects)
        link = rig.link or STUDY_LINK
        motion = MotionConfig(
            amplitude_rad=config.amplitude_rad, period_s=config.period_s,
            phase_2_rad=config.phase_2_rad,
        ).with_motion(config.motion)  # fmt: skip
        trial = run_case(
            rig,
            TrialCase(
                motion.motion(config.dof), config.payload_kg, config.trial, config.seed,
                link.pressure_pa if config.pressure_pa is None else config.pressure_pa,
                link.gravity.unit,
            ),
        )  # fmt: skip
        columns = {n: c for n, c in trial.columns.items() if not n.startswith("m")}
        columns["di"] = deformation_index(trial)
        meta = trial.meta
        rigid = rigid_tip_m(trial.angle_rad, meta.base_offset_m, meta.link_length_m)
        digest = hashlib.sha256()
        for name, column in sorted(trial.columns.items()):
            digest.update(name.encode() + np.ascontiguousarray(column).tobytes())
        found = {
            "name": trial.name,
            "rows": len(trial),
            "rms": {n: _rms(c) for n, c in columns.items() if n != "time_s"},
            "largest": {n: float(np.nanmax(np.abs(c))) for n, c in columns.items()},
            "rigid_tip_rms_m": _rms(np.linalg.norm(rigid - trial.tip_m, axis=1)),
            "trial_sha256": digest.hexdigest(),
        }
        if config.plant is not None:
            comparison = compare_with_trials(_plant(config.plant), [trial])[0]
            found["plant_rms"] = {n: _rms(comparison.error(n)) for n in comparison.simulated}
        return found


KIND = RigKind()


def changed_rig(name: str, factors: dict[str, float]) -> Any:
    """Return a rig with factors applied to its parameters."""
    from models.rig.drawn import rig_named

    rig = rig_named(name)
    if unknown := sorted(factors.keys() - set(rig)):
        raise InputError(f"factors.{unknown[0]}", "is no parameter of the rig", "see rig.toml")
    return rig.changed(**{n: factor * rig[n] for n, factor in factors.items()})


@functools.lru_cache(maxsize=8)
def _plant(path: str) -> Any:
    from models.plant.plant import read_plant  # loads CasADi

    return read_plant(path)


def _rms(values: Any) -> float:
    import numpy as np

    return float(np.sqrt(np.nanmean(np.square(values))))
