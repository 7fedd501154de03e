"""List of the trials of a directory; a trial that lacks one of its two files is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from firmware_py.errors import InputError
from firmware_py.files.input_files import read_toml

_OF_A_TRIAL: Final = {"motion", "rest_samples", "trial"}
"""Keys that every trial's conditions have and that no other document combines."""


def sample_files(directory: Path) -> list[Path]:
    """CSV files of the trials of a directory, in order; the suffix may be in capitals.

    Other TOML files, such as a map or a plant, may lie beside them.
    """
    try:
        files = sorted(directory.iterdir())
    except OSError as error:
        remedy = "name a directory of trials"
        raise InputError(directory, f"cannot be read ({error.strerror})", remedy) from None
    paths: dict[str, Path] = {}
    for path in (p for p in files if p.suffix.lower() == ".csv"):
        other = paths.setdefault(path.stem, path)
        if other is not path:
            what = f"has the name of the trial {other.name}"
            raise InputError(path, what, "rename or remove one of the two")
    sampled = {name.casefold() for name in paths}  # a file system may ignore the case
    for path in (p for p in files if p.suffix.lower() == ".toml"):
        if path.stem.casefold() not in sampled and _holds_conditions(path):
            what = f"is a trial without samples: {path.stem}.csv is missing"
            raise InputError(path, what, "put it beside this file, or remove this file")
    return list(paths.values())


def conditions_beside(samples: Path) -> Path:
    """Path of a trial's TOML file, existing or not; its suffix may be in capitals."""
    usual = samples.with_suffix(".toml")
    if usual.exists():
        return usual
    others = sorted(p for p in samples.parent.glob("*") if p.suffix.lower() == ".toml")
    return next((p for p in others if p.stem == samples.stem), usual)


def _holds_conditions(path: Path) -> bool:
    """Whether a TOML file is that of a trial's conditions; in a map, `trial` is a table."""
    try:
        document = read_toml(path)
    except InputError:
        return False
    return document.keys() >= _OF_A_TRIAL and not isinstance(document["trial"], dict)
