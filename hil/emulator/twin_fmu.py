"""Build the twin FMU of a plant file, for use behind the emulated servos.

This is separate from `hil.emulator.physics` so that the emulator's process loads neither a compiler
nor a computer algebra system.
"""

from __future__ import annotations

from pathlib import Path

from firmware_py.inference.fmi_platform import platform_here
from fmu.fmu_builder import build_fmu
from fmu.packaging import platform_names
from models.plant.plant import read_plant


def build_twin(plant: Path, dof: int, directory: Path) -> Path:
    """Build the twin FMU for this machine, without a predictor; return the .fmu file."""
    platforms = platform_names(platform_here())
    model = read_plant(plant).step_model(dof, "twin")
    return build_fmu(model, directory / f"twin_{dof}dof.fmu", platforms=platforms)
