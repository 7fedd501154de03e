"""Files of a calibration, in a directory beside the plant file."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from firmware_py.core.errors import InputError
from models.gap.estimation.own_error import ModelDiscrepancy, read_patterns

FINGERPRINT: Final = "fingerprint.txt"
"""File with the hash of the work that the files were measured in and, below it, that of
the plant."""

OWN_FILES: Final = (
    FINGERPRINT, "own_error_*.npz", "patterns.npz", "patterns.part.npz", "plants/drawn_*.json",
)  # fmt: skip
"""Files that a calibration writes, partly written ones included."""


def calibration_directory(plant: Path) -> Path:
    return plant.with_suffix(".calibration")


def patterns_file(plant: Path) -> Path:
    return calibration_directory(plant) / "patterns.npz"


def patterns_beside(plant: Path, sha256: str) -> tuple[ModelDiscrepancy, ...]:
    """Patterns that were measured for a plant; empty if there are none."""
    path, directory = patterns_file(plant), calibration_directory(plant)
    if not path.exists():
        return ()
    fingerprint = directory / FINGERPRINT
    lines = fingerprint.read_text(encoding="utf-8").splitlines() if fingerprint.exists() else []
    if lines[1:] not in ([], [sha256]):
        raise InputError(
            directory, f"was measured for another plant than {plant.name} is now",
            "run dropstitch calibrate again, or remove it",
        )  # fmt: skip
    return read_patterns(path)


def begin_work(fingerprint: str, plant_sha256: str, directory: Path) -> None:
    """Keep files that were measured for the same trials and plant, and remove those for others.

    Files that no calibration writes are kept.
    """
    path = directory / FINGERPRINT
    lines = [fingerprint, plant_sha256]
    if path.exists() and path.read_text(encoding="utf-8").splitlines() != lines:
        for pattern in OWN_FILES:
            for old in directory.glob(pattern):
                old.unlink()
    directory.mkdir(parents=True, exist_ok=True)
    path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8", newline="\n")
