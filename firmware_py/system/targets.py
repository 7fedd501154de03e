"""Targets of the project that code compares results with, each stated here only."""

from __future__ import annotations

from typing import Final

OWN_COST_P99_NS: Final = 1_000_000
"""Of a tick in real time without its wait for the bus."""

DI_GAIN_DEGREE: Final = "3"
"""Degree of the polynomials at which the gain by the observer's DI is shown."""

FMU_PARITY: Final = 1e-9
"""Largest difference of an FMU from the interpreted model, in SI units. [assumed: a nanometre]"""

PATH_RMS_TO_RIGID: Final = {"known": 1 / 25, "unknown": 1 / 20}
"""RMS distance of the tip from a plan's path over that of rigid kinematics, by what is known of the
payload."""
