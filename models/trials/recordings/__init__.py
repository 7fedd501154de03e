"""Importers: readers of the files that other systems record, and their assembly into trials.

Every reader takes a file and a `RecordingMap` and returns a list of `Series`: the channels of the
file under the column names of a trial, in SI units, markers in the frame of the file. Each series
has separate sample times, all on the clock of that file. `synchronise` estimates the offset between
two files; `assemble_trial` resamples everything to one uniform step. A new importer is a module
with such a reader and a row of `READERS`.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

from firmware_py.core.errors import InputError
from models.trials.recordings.c3d import read_c3d
from models.trials.recordings.frames import in_world
from models.trials.recordings.mapping import RecordingMap
from models.trials.recordings.motive import read_motive_csv
from models.trials.recordings.robot_log import read_robot_log
from models.trials.recordings.rosbag import read_ros2_bag
from models.trials.recordings.series import Series
from models.trials.recordings.table import read_table

READERS: Final[dict[str, Callable[[Path, RecordingMap], list[Series]]]] = {
    "motive": read_motive_csv,
    "c3d": read_c3d,
    "rosbag": read_ros2_bag,
    "recording": read_robot_log,
    "table": read_table,
}
"""Readers by their name in `dropstitch import --as`."""

KINDS: Final = tuple(READERS)
UP: Final = {"motive": "y"}
"""Upward axis by format, unless the map's `[frame]` says otherwise; z in all other formats."""
_KIND_OF_SUFFIX: Final = {".mcap": "recording", ".c3d": "c3d"}


def read_series(path: Path, kind: str | None, mapping: RecordingMap) -> list[Series]:
    """Read the channels of a file, the markers in the world frame.

    `kind` is one of `KINDS`. None selects by the suffix: `.mcap` is a log of `dropstitch run`,
    `.c3d` is C3D, a directory is a rosbag, anything else a table.
    """
    if not path.exists():
        raise InputError(path, "is missing", "name an existing file")
    kind = kind or (
        "rosbag" if path.is_dir() else _KIND_OF_SUFFIX.get(path.suffix.lower(), "table")
    )
    in_file = READERS[kind](path, mapping)
    return [in_world(s, mapping.known_markers, mapping.frame, UP.get(kind, "z")) for s in in_file]
