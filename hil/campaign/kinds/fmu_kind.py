"""Kind of cases: run of an FMU in FMPy along a motion."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from firmware_py.core.errors import InputError
from firmware_py.core.signals import PERIOD_S
from hil.campaign.kinds.case_kind import CaseKind, MotionOptions
from hil.campaign.kinds.rig_kind import columns_sha256, rms


class FmuOptions(MotionOptions, frozen=True, kw_only=True):
    """Options of a run of an FMU."""

    fmu: str
    payload_kg: Annotated[float, Meta(ge=0, le=20)] = 1.0
    step_s: Annotated[float, Meta(ge=1e-5, le=1)] = PERIOD_S
    # Plant parameters to set before the start, such as `link_mass_kg`
    parameters: dict[str, float] = msgspec.field(default_factory=dict)

    def files(self) -> dict[str, str]:
        return super().files() | {"fmu": self.fmu}


def run_fmu(options: FmuOptions, scratch: Path) -> dict[str, Any]:
    from fmu.fmpy_instance import FmuArchive  # loads FMPy
    from fmu.fmpy_run import simulate_fmu

    parameters = {f"parameters.{n}": v for n, v in options.parameters.items()}
    with FmuArchive(options.fmu) as archive:
        joints = sum(
            v.name.startswith(("goal_", "angle_")) and v.causality == "input"
            for v in archive.description.modelVariables
        )
        if joints not in (1, 2):
            raise InputError(
                options.fmu, "has no joints", "give one that 'dropstitch fmu build' wrote"
            )
        motion = options.motion_config().motion(joints)
        run = simulate_fmu(archive, motion, options.payload_kg, options.step_s, parameters)
    return {
        "rows": len(run.time_s),
        "rms": {n: rms(c) for n, c in run.columns.items()},
        "largest": {n: float(np.max(np.abs(c))) for n, c in run.columns.items()},
        "last": {n: float(c[-1]) for n, c in run.columns.items()},
        "columns_sha256": columns_sha256(run.columns),
    }


KIND = CaseKind(
    name="fmu",
    options=FmuOptions,
    run=run_fmu,
    sources=("firmware_py", "models", "fmu", "hil/campaign/kinds"),
    figures={
        "rms.tip_x_m": "tip x, RMS",
        "largest.di": "largest DI",
        "largest.current_1_a": "largest current of servo 1",
    },
)
