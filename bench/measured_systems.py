"""Measured systems of the benchmark on recordings: where they are, and what is left out in turn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

from models.trials.trial import Trial

BASELINE: Final = "viscous + Coulomb"
FOUND: Final = "named by the program"
PLAIN: Final = "nothing named"
PUBLISHED: Final = "viscous + Coulomb + offset"
GAIN, MOTION, RECORD, BLOCK = "gain", "motion", "record", "block of time"


@dataclass(frozen=True)
class MeasuredSystem:
    """Recordings of one machine."""

    name: str  # Of its plant and map
    folder: str
    pattern: str
    signal: str
    unit: str  # In which errors are shown
    factor: float
    measure: str  # Key of the error of `errors_by_trial`: "mae" or "rms"
    ladder: dict[str, tuple[str, ...]]  # Effects beside viscous friction of fits to compare with
    # By what is left out: its value in a trial. Every value is left out in turn; of a single
    # recording those of its blocks of time (`models.gap.residuals.time_blocks`).
    leave_out: dict[str, Callable[[Trial], float | str]] = field(default_factory=dict)
    # Whether the plant is identified before the gap is looked for. A joint that nothing holds and
    # whose friction is missing is not: the fit of the whole recording makes up for it by values at
    # their bounds, from where no effect helps.
    identified_first: bool = True


SYSTEMS: Final = (
    MeasuredSystem(
        "xl330_pendulum", "bam_xl330", "*.json", "angle_1_rad", "mrad", 1e3, "mae",
        {BASELINE: ("coulomb_friction",)},
        {GAIN: lambda t: t.meta.conditions["duty_gain_1"], MOTION: lambda t: t.meta.motion},
    ),
    MeasuredSystem(
        "emps", "emps", "*.mat", "position_1_m", "mm", 1e3, "rms",
        {"viscous": (), BASELINE: ("coulomb_friction",), "viscous + offset": ("load_offset",),
         PUBLISHED: ("coulomb_friction", "load_offset")},
        {BLOCK: lambda t: t.meta.motion},
    ),
    MeasuredSystem(
        "flexible_link", "quanser", "lqg_step_*.mat", "deflection_1_rad", "mrad", 1e3, "rms",
        {PLAIN: ()}, {RECORD: lambda t: t.name},
    ),
    MeasuredSystem(
        "driven_flexible_link", "quanser", "lqr_full_*.mat", "angle_1_rad", "mrad", 1e3, "rms",
        {PLAIN: (), BASELINE: ("coulomb_friction",)}, {BLOCK: lambda t: t.meta.motion},
        identified_first=False,
    ),
)  # fmt: skip
