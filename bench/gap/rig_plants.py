"""Plants of the benchmark, one identified on trials of each rig without a hidden effect."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from bench.gap.case_run import PAYLOADS_KG
from firmware_py.motion import Motion
from models.gap.estimation.noise_floor_fit import with_noise_floor
from models.plant.identification.identification import identify
from models.plant.plant import read_plant
from models.rig.drawn_rig import rig_named
from models.rig.rig_parameters import RigParameters
from models.rig.study_protocol import run_case
from models.rig.trial_case import TrialCase
from models.trials.trial_files import TrialSet

SEED: Final = 1
"""Of the trials of identification; the cases draw others."""


def plant_of_rig(rig: str, directory: Path) -> Path:
    """Plant file of a rig; identified where it is not there yet.

    Parameters
    ----------
    rig : str
        Name of a rig.
    directory : Path
        Of the plant files.
    """
    return plant_for(rig_named(rig), directory / f"{rig}.json")


def plant_for(rig: RigParameters, path: Path) -> Path:
    """Plant file, identified on trials of a rig where it is not there yet.

    Parameters
    ----------
    rig : RigParameters
        Without a hidden effect.
    path : Path
        Of the file.
    """
    if not path.exists():
        trials = TrialSet(
            tuple(
                run_case(rig, TrialCase(Motion(), payload_kg, trial, SEED))
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
