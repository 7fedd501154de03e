"""Check of an earlier import: which recording the trial to be replaced came from.

An imported trial stores the hash of its recording (`TrialMeta.recording_sha256`). You may import
the same recording again, for example with another map. A trial of another recording, or a file
that is no trial, is never replaced.
"""

from __future__ import annotations

import hashlib
import os
from itertools import islice
from pathlib import Path
from typing import Final

from firmware_py.errors import InputError
from firmware_py.files.input_files import open_bounded, read_toml

_MOST_FILES: Final = 1000
"""Most files of a folder that are hashed; the reader of bags accepts fewer."""
_PART_BYTES: Final = 1 << 20
_REMEDY: Final = "give another --out, or move it away"


def recording_hash(path: Path) -> str:
    """SHA-256 of a recording; for a folder (a ROS 2 bag), over its files in order of name."""
    is_bag = path.is_dir()
    files = sorted(islice(path.iterdir(), _MOST_FILES)) if is_bag else [path]
    digest = hashlib.sha256()
    for file in files:
        if is_bag:
            digest.update(b"\0" + file.name.encode("utf-8", "surrogateescape") + b"\0")
        with open_bounded(file, "name an existing file") as stream:
            while part := stream.read(_PART_BYTES):
                digest.update(part)
    return digest.hexdigest()


def check_earlier_import(directory: Path, name: str, recording_sha256: str) -> None:
    """Refuse to replace a trial of another recording, or files that are no trial."""
    samples, conditions = directory / f"{name}.csv", directory / f"{name}.toml"
    there = [path for path in (samples, conditions) if os.path.lexists(path)]
    if not there:
        return
    try:
        document = read_toml(conditions)
    except InputError:
        document = {}
    known = document.get("recording_sha256")
    if known is None:
        raise InputError(there[0], "would be replaced, and is no imported trial", _REMEDY)
    if known != recording_sha256:
        raise InputError(there[0], "is a trial of another recording", _REMEDY)
