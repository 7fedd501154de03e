"""Files of a calibration, in a directory beside the plant file."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from models.gap.estimation.model_discrepancy import ModelDiscrepancy, read_patterns

FINGERPRINT: Final = "fingerprint.txt"
"""Of the trials and the plant that the files were measured for."""

OWN_FILES: Final = (
    FINGERPRINT, "own_error_*.npz", "patterns.npz", "patterns.part.npz", "patterns.svg",
    "plants/drawn_*.json",
)  # fmt: skip
"""Files that a calibration writes, halves that were left included."""


def calibration_directory(plant: Path) -> Path:
    """Directory of the calibration of a plant.

    Parameters
    ----------
    plant : Path
        Of the plant file.

    Examples
    --------
    >>> calibration_directory(Path("build/plant.json")).as_posix()
    'build/plant.calibration'
    """
    return plant.with_suffix(".calibration")


def patterns_file(plant: Path) -> Path:
    """File of the patterns that belong to a plant.

    Parameters
    ----------
    plant : Path
        Of the plant file.
    """
    return calibration_directory(plant) / "patterns.npz"


def patterns_beside(plant: Path) -> tuple[ModelDiscrepancy, ...]:
    """Patterns that were measured for a plant; none where nobody did.

    Parameters
    ----------
    plant : Path
        Of the plant file.

    Raises
    ------
    InputError
        If their file is damaged.
    """
    path = patterns_file(plant)
    return read_patterns(path) if path.exists() else ()


def begin_work(fingerprint: str, directory: Path) -> None:
    """Keep what was measured for the same trials and plant, remove what was for others.

    Files that no calibration writes stay.

    Parameters
    ----------
    fingerprint : str
        Of the work, see `models.gap.calibration.pattern_measurement.PatternWork.fingerprint`.
    directory : Path
        Of the calibration.
    """
    path = directory / FINGERPRINT
    if path.exists() and path.read_text() != fingerprint:
        for pattern in OWN_FILES:
            for old in directory.glob(pattern):
                old.unlink()
    directory.mkdir(parents=True, exist_ok=True)
    path.write_text(fingerprint)
