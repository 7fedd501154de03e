"""Version of the code that computes a case: hash of its sources and of its libraries' versions.

The hash of a commit would change with every page of the docs, and would miss uncommitted files. A
hash of the sources covers what runs, and every worker can compute its own. Commands and pages
compute no results and are excluded. Another version of a library may give other digits, so the
versions are included.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import os
import platform
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import read_bytes

ROOT: Final = Path(__file__).resolve().parents[2]
NOT_COMPUTING: Final = frozenset({"commands", "report", "scores", "__pycache__"})
"""Folders of a room whose code computes no result."""
CAMPAIGN: Final = "hil/campaign/"
KINDS_OF_CASES: Final = "hil/campaign/kinds/"
"""The only folder of `CAMPAIGN` that computes; the rest transports, stores and shows results."""
LIBRARIES: Final = (
    "numpy", "scipy", "scikit-learn", "onnxruntime", "casadi", "mujoco", "pyelastica", "fmpy",
    "msgspec", "ziglang",
)  # fmt: skip
MOST_FILES: Final = 10_000
"""Largest number of files in a directory that a case names: 100 times a study's trials
[assumed]."""


@functools.cache
def code_version(rooms: tuple[str, ...]) -> str:
    """Return the version of the code of some rooms on this machine, 16 hexadecimal digits."""
    digest = hashlib.sha256()
    for room in rooms:
        for path in _sources(ROOT / room):
            digest.update(path.relative_to(ROOT).as_posix().encode() + b"\0")
            digest.update(hashlib.sha256(path.read_bytes()).digest())
    versions = [f"{name} {_version(name)}" for name in LIBRARIES]
    minor = ".".join(platform.python_version_tuple()[:2])
    digest.update("\n".join([*versions, f"python {minor}"]).encode())
    return digest.hexdigest()[:16]


def _sources(room: Path) -> Iterable[Path]:
    for path in sorted(room.rglob("*")):
        place = path.relative_to(ROOT)
        if path.is_file() and not NOT_COMPUTING & set(place.parts) and path.suffix != ".md":
            name = place.as_posix()
            if not name.startswith(CAMPAIGN) or name.startswith(KINDS_OF_CASES):
                yield path


def _version(library: str) -> str:
    try:
        return importlib.metadata.version(library)
    except importlib.metadata.PackageNotFoundError:
        return "none"


@functools.lru_cache(maxsize=4096)
def content_sha256(path: Path) -> str:
    """Return the SHA-256 of a file, or of the names and contents of all files in a directory."""
    remedy = "name a file or a directory that can be read"
    if not os.path.isdir(path):  # also False for a name that is too long
        return hashlib.sha256(read_bytes(path, remedy)).hexdigest()
    digest = hashlib.sha256()
    for file in _files_of(path, remedy):
        digest.update(str(file.relative_to(path)).encode(errors="surrogateescape") + b"\0")
        digest.update(hashlib.sha256(read_bytes(file, remedy)).digest())
    return digest.hexdigest()


def _files_of(directory: Path, remedy: str) -> list[Path]:
    """Regular files of a directory, sorted; links to directories are not followed."""
    found: list[Path] = []
    for folder, _, names in os.walk(directory):
        try:
            found += [file for name in names if (file := Path(folder, name)).is_file()]
        except OSError as error:
            raise InputError(directory, f"cannot be read ({error.strerror})", remedy) from None
        if len(found) > MOST_FILES:
            raise InputError(directory, f"holds more than {MOST_FILES} files", remedy)
    return sorted(found)
