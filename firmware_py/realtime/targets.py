"""Targets of the project that code compares results with, each defined only here.

`docs/claims.toml` has the targets of all figures in the documentation; a test compares the two.
"""

from __future__ import annotations

from typing import Final

OWN_COST_P50_NS: Final = 500_000
OWN_COST_P99_NS: Final = 1_000_000
"""99th percentile of a tick's computing time, without the wait for the bus; claims `loop-own-…`."""

PLANT_TIP_RMS_M: Final = {
    "held-out trials": {1: 2.0e-3, 2: 2.6e-3},
    "unseen 20° motion": {1: 1.7e-3, 2: 2.3e-3},
    "unseen multisine": {1: 1.6e-3, 2: 2.5e-3},
}
"""Tip error of the plant of `make demo` on the default rig's trials, by trials and joints; claims
`plant-tip-…`."""

DI_GAIN_DEGREE: Final = "3"
DI_GAIN_FRACTION: Final = {"trial_2": 0.9, "unseen_20deg": 0.8}
"""Fraction of the true DI's gain that the observer's DI retains, by test; claims `study-gain-…`."""

FMU_PARITY: Final = 1e-9
"""Largest difference between FMU and interpreted model, in SI units. [assumed: a nanometre]"""

PATH_RMS_TO_RIGID: Final = {"known": 1 / 25, "unknown": 1 / 20}
"""Ratio of a plan's RMS distance from the path to that of rigid kinematics, for a known and for an
unknown payload; claims `plans-…`."""
