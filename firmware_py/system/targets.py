"""Targets of the project that code compares results with, each stated here only."""

from __future__ import annotations

from typing import Final

OWN_COST_P99_NS: Final = 1_000_000
"""Of a tick in real time without its wait for the bus."""

PLANT_TIP_RMS_M: Final = {
    "held-out trials": {1: 2.0e-3, 2: 2.6e-3},
    "unseen 20° motion": {1: 1.7e-3, 2: 2.3e-3},
    "unseen multisine": {1: 1.6e-3, 2: 2.5e-3},
}
"""Tip error of the plant of `make demo` on the default rig's trials, by trials and joints."""

DI_GAIN_DEGREE: Final = "3"
DI_GAIN_FRACTION: Final = {"trial_2": 0.9, "unseen_20deg": 0.8}
"""Part of the true DI's gain that the observer's DI recovers, by test."""

FMU_PARITY: Final = 1e-9
"""Largest difference of an FMU from the interpreted model, in SI units. [assumed: a nanometre]"""

PATH_RMS_TO_RIGID: Final = {"known": 1 / 25, "unknown": 1 / 20}
"""RMS distance of the tip from a plan's path over that of rigid kinematics, by what is known of the
payload."""
