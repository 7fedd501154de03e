"""Plants that are identified on trials of a rig without a hidden effect."""

from __future__ import annotations

import zlib
from collections.abc import Collection
from concurrent.futures import as_completed
from pathlib import Path

from firmware_py.console import Progress
from firmware_py.errors import InputError
from models.gap.calibration.drawn_plants import plant_on_rig
from models.gap.calibration.protocol import repeated
from models.gap.estimation.noise_floor import NoiseFloor
from models.gap.estimation.noise_floor_fit import noise_floor_of
from models.gap.training.cases import PAYLOADS_KG, motion_named
from models.plant.plant import Plant
from models.rig.drawn import rig_named
from models.rig.protocol import TrialCase
from models.shared.worker_pool import worker_pool

Robot = tuple[str, int, str]
"""Rig, driven joints and motion: what a plant is identified on."""


def plant_of_rig(rig: str, directory: Path, joints: int = 1, motion: str = "study") -> Path:
    """Plant file of a rig; identified where it is not there yet.

    A plant for two joints is identified on motions of one joint and of both, as the study's.
    """
    seed = zlib.crc32(f"identification of {rig}".encode())  # rigs share no noise
    cases = repeated(identification_cases(joints, motion), 2, seed)
    return plant_on_rig(rig_named(rig), cases, plant_path(directory, rig, joints, motion))


def plants_of_rigs(robots: Collection[Robot], directory: Path) -> dict[Robot, Path]:
    """Plant file of each robot; those that are not there yet are identified, two at a time."""
    missing = [robot for robot in robots if not plant_path(directory, *robot).exists()]
    if len(missing) > 1:
        progress = Progress("plants of the rigs", len(missing))
        with worker_pool(2) as pool:
            begun = [
                pool.submit(plant_of_rig, rig, directory, joints, motion)
                for rig, joints, motion in missing
            ]
            for done in as_completed(begun):
                progress.step(done.result().stem)
    return {
        (rig, joints, motion): plant_of_rig(rig, directory, joints, motion)
        for rig, joints, motion in robots
    }


def plant_path(directory: Path, rig: str, joints: int, motion: str) -> Path:
    """Where the plant of a rig is written; the parameters are those of `plant_of_rig`."""
    name = rig if joints == 1 else f"{rig}_{joints}dof"
    name += "" if motion == "study" else f"_{motion}"
    return directory / f"{name}.json"


def identification_cases(joints: int, motion: str) -> tuple[TrialCase, ...]:
    """Conditions that a plant is identified on."""
    return tuple(
        TrialCase(motion_named(motion, dof), payload_kg, 1)
        for dof in range(1, joints + 1)
        for payload_kg in PAYLOADS_KG
    )


def required_noise_floor(plant: Plant, joints: int = 1) -> NoiseFloor:
    """Noise floor of a plant for one joint or two."""
    floor = noise_floor_of(plant, joints)
    if floor is None:
        raise InputError(plant.name, "carries no noise floor", "identify it on repeated trials")
    return floor
