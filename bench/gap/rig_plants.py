"""Plants of the benchmark, one identified on trials of each rig without a hidden effect."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from bench.gap.cases import PAYLOADS_KG, motion_named
from firmware_py.errors import InputError
from models.gap.estimation.noise_floor import NoiseFloor
from models.gap.estimation.noise_floor_fit import noise_floor_of, with_noise_floor
from models.plant.identification.identification import identify
from models.plant.plant import Plant, read_plant
from models.rig.drawn_rig import rig_named
from models.rig.rig_parameters import RigParameters
from models.rig.study_protocol import run_case
from models.rig.trial_case import TrialCase
from models.trials.trial_files import TrialSet

SEED: Final = 1
"""Of the trials of identification; the cases draw others."""


def plant_of_rig(rig: str, directory: Path, joints: int = 1, motion: str = "study") -> Path:
    """Plant file of a rig; identified where it is not there yet.

    A plant for two joints is identified on motions of one joint and of both, as the study's.

    Parameters
    ----------
    rig : str
        Name of a rig.
    directory : Path
        Of the plant files.
    joints : int
        Driven joints, 1 or 2.
    motion : str
        Name of the motion, of `bench.gap.cases.MOTIONS`.
    """
    name = rig if joints == 1 else f"{rig}_{joints}dof"
    name += "" if motion == "study" else f"_{motion}"
    return plant_for(rig_named(rig), directory / f"{name}.json", joints, motion)


def plant_for(rig: RigParameters, path: Path, joints: int = 1, motion: str = "study") -> Path:
    """Plant file, identified on trials of a rig where it is not there yet.

    Parameters
    ----------
    rig : RigParameters
        Without a hidden effect.
    path : Path
        Of the file.
    joints : int
        Driven joints of the robot, 1 or 2.
    motion : str
        Name of the motion, of `bench.gap.cases.MOTIONS`.
    """
    if not path.exists():
        trials = TrialSet(
            tuple(
                run_case(rig, TrialCase(motion_named(motion, dof), payload_kg, trial, SEED))
                for dof in range(1, joints + 1)
                for payload_kg in PAYLOADS_KG
                for trial in (1, 2)
            )
        )
        found = with_noise_floor(identify(read_plant(), trials).plant, trials.trials)
        path.parent.mkdir(parents=True, exist_ok=True)
        fresh = path.with_suffix(".part.json")
        found.write(fresh)
        fresh.replace(path)
    return path


def required_noise_floor(plant: Plant, joints: int = 1) -> NoiseFloor:
    """Noise floor of a plant for one joint or two.

    Parameters
    ----------
    plant : Plant
        Identified on repeated trials.
    joints : int
        Driven joints, 1 or 2.

    Raises
    ------
    InputError
        If the plant carries none.
    """
    floor = noise_floor_of(plant, joints)
    if floor is None:
        raise InputError(plant.name, "carries no noise floor", "identify it on repeated trials")
    return floor
