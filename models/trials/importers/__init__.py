"""Turn what laboratories record into trials.

Every reader is a module with one function, ``read(path, mapping) -> list[Series]``: the channels
of the file under the contract's names, in SI units, each series on its own sample times, all on
the clock of that file. `synchronise` finds the offset between two files, `assemble` resamples
everything to one uniform step and makes a trial of it.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Final

from firmware_py.errors import InputError
from models.trials.importers.mapping import Mapping
from models.trials.importers.series import Series

_MODULES: Final = {
    "motive": "motive_csv",
    "c3d": "c3d_file",
    "rosbag": "ros2_bag",
    "recording": "robot_log",
    "table": "table_file",
}
KINDS: Final = tuple(_MODULES)
_KIND_OF_SUFFIX: Final = {".mcap": "recording", ".c3d": "c3d"}


def read_series(path: Path, kind: str | None, mapping: Mapping) -> list[Series]:
    """Read the channels of a file.

    Parameters
    ----------
    path : Path
        The file (for a rosbag also its directory).
    kind : str or None
        One of `KINDS`; None goes by the suffix: `.mcap` is our own recording, `.c3d` is C3D, a
        directory is a rosbag, anything else a table.
    mapping : Mapping
        What the file cannot say about itself.

    Raises
    ------
    InputError
        If the file is missing or cannot be used.
    """
    if not path.exists():
        raise InputError(path, "is missing", "name an existing file")
    kind = kind or ("rosbag" if path.is_dir() else _KIND_OF_SUFFIX.get(path.suffix, "table"))
    module = importlib.import_module(f"{__name__}.{_MODULES[kind]}")
    series: list[Series] = module.read(path, mapping)
    return series
