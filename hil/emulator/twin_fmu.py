"""Twin FMU of a plant document, for use behind the emulated servos.

Apart from `hil.emulator.physics`, so that the emulator's process does not load a compiler and a
computer algebra system.
"""

from __future__ import annotations

from pathlib import Path

from fmu.fmu_builder import build_fmu
from models.plant.plant import read_plant


def build_twin(plant: Path, dof: int, directory: Path) -> Path:
    """Build the twin of a plant document, without a predictor; returns the .fmu file.

    Raises
    ------
    InputError
        If the document cannot be used.
    """
    return build_fmu(read_plant(plant).step_model(dof, "twin"), directory / f"twin_{dof}dof.fmu")
