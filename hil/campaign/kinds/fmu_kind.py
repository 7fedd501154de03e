"""Kind of cases: run of an FMU in FMPy along a motion."""

from __future__ import annotations

import hashlib
from typing import Any, ClassVar

import msgspec

from firmware_py.core.errors import InputError
from firmware_py.core.motion import KINDS as MOTIONS
from firmware_py.core.motion import STUDY_AMPLITUDE_RAD, STUDY_PERIOD_S
from firmware_py.core.signals import PERIOD_S
from hil.campaign.kinds.case_kind import CaseConfig, CaseContext, CaseKind
from hil.campaign.kinds.config_checks import check_ranges


class FmuConfig(CaseConfig, frozen=True, kw_only=True):
    """Configuration of a run of an FMU."""

    fmu: str
    motion: str = "sinusoid"  # Kind of motion, or a motion file
    amplitude_rad: float = STUDY_AMPLITUDE_RAD
    period_s: float = STUDY_PERIOD_S
    phase_2_rad: float = 0.0
    payload_kg: float = 1.0
    step_s: float = PERIOD_S
    # Plant parameters to set before the start, such as `link_mass_kg`
    parameters: dict[str, float] = msgspec.field(default_factory=dict)


class FmuKind(CaseKind[FmuConfig]):
    """Runs of an FMU."""

    name: ClassVar[str] = "fmu"
    config: ClassVar[type[FmuConfig]] = FmuConfig
    rooms: ClassVar[tuple[str, ...]] = ("firmware_py", "models", "fmu", "hil/campaign/kinds")
    figures: ClassVar = {
        "rms.tip_x_m": "tip x, RMS",
        "largest.di": "largest DI",
        "largest.current_1_a": "largest current of servo 1",
    }

    def files(self, config: FmuConfig) -> dict[str, str]:
        found = {"fmu": config.fmu}
        if config.motion not in MOTIONS:
            found["motion"] = config.motion
        return found

    def check(self, config: FmuConfig) -> None:
        check_ranges(config, payload_kg=(0.0, 20.0), period_s=(0.1, 1e4), step_s=(1e-5, 1.0))

    def run(self, config: FmuConfig, context: CaseContext) -> dict[str, Any]:
        import numpy as np

        from firmware_py.core.motion import MotionConfig
        from fmu.fmpy_instance import FmuArchive  # loads FMPy
        from fmu.fmpy_run import simulate_fmu

        motion = MotionConfig(
            amplitude_rad=config.amplitude_rad, period_s=config.period_s,
            phase_2_rad=config.phase_2_rad,
        ).with_motion(config.motion)  # fmt: skip
        parameters = {f"parameters.{n}": v for n, v in config.parameters.items()}
        with FmuArchive(config.fmu) as archive:
            joints = sum(
                v.name.startswith(("goal_", "angle_")) and v.causality == "input"
                for v in archive.description.modelVariables
            )
            if joints not in (1, 2):
                raise InputError(
                    config.fmu, "has no joints", "give one that 'dropstitch fmu build' wrote"
                )
            run = simulate_fmu(
                archive, motion.motion(joints), config.payload_kg, config.step_s, parameters
            )
        digest = hashlib.sha256()
        for name, column in sorted(run.columns.items()):
            digest.update(name.encode() + np.ascontiguousarray(column).tobytes())
        return {
            "rows": len(run.time_s),
            "rms": {n: float(np.sqrt(np.mean(c**2))) for n, c in run.columns.items()},
            "largest": {n: float(np.max(np.abs(c))) for n, c in run.columns.items()},
            "last": {n: float(c[-1]) for n, c in run.columns.items()},
            "columns_sha256": digest.hexdigest(),
        }


KIND = FmuKind()
