"""Twin FMU of a plant file, for use behind the emulated servos.

Separate from `hil.emulator.physics` so that the emulator's process does not load a compiler and a
computer algebra system.
"""

from __future__ import annotations

from pathlib import Path

from fmu.fmu_builder import build_fmu
from models.plant.plant import read_plant


def build_twin(plant: Path, dof: int, directory: Path) -> Path:
    """Build the twin of a plant file, without a predictor; return the .fmu file.

    Parameters
    ----------
    plant : Path
        Plant file.
    dof : int
        Number of joints.
    directory : Path
        Directory of the FMU.

    Raises
    ------
    InputError
        If the file cannot be used.
    """
    return build_fmu(read_plant(plant).step_model(dof, "twin"), directory / f"twin_{dof}dof.fmu")
