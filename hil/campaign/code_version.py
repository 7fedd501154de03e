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
from pathlib import Path
from typing import Final

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import read_bytes

ROOT: Final = Path(__file__).resolve().parents[2]
NOT_COMPUTING: Final = frozenset({"commands", "report", "__pycache__"})
"""Folders of a room whose code computes no result."""
LIBRARIES: Final = (
    "numpy", "scipy", "scikit-learn", "onnxruntime", "casadi", "mujoco", "pyelastica", "fmpy",
    "msgspec", "ziglang",
)  # fmt: skip
MOST_FILES: Final = 10_000
"""Largest number of files in a directory that a case names: 100 times a study's trials
[assumed]."""


@functools.cache
def code_version(folders: tuple[str, ...]) -> str:
    """Return the version of the code of some folders on this machine, 16 hexadecimal digits."""
    digest = hashlib.sha256()
    for path in (p for folder in folders for p in sorted((ROOT / folder).rglob("*"))):
        name = path.relative_to(ROOT).as_posix()
        # Of the campaign, only the kinds compute; the rest transports, stores and shows results.
        shows = name.startswith("hil/campaign/") and not name.startswith("hil/campaign/kinds/")
        computes = not shows and not NOT_COMPUTING & set(name.split("/"))
        if computes and path.suffix != ".md" and path.is_file():
            digest.update(name.encode() + b"\0")
            digest.update(hashlib.sha256(path.read_bytes()).digest())
    versions = [f"{name} {_version(name)}" for name in LIBRARIES]
    minor = ".".join(platform.python_version_tuple()[:2])
    digest.update("\n".join([*versions, f"python {minor}"]).encode())
    return digest.hexdigest()[:16]


def _version(library: str) -> str:
    try:
        return importlib.metadata.version(library)
    except importlib.metadata.PackageNotFoundError:
        return "none"


def content_sha256(path: Path) -> str:
    """Return the SHA-256 of a file, or of the names and contents of all files in a directory.

    Links to directories are not followed.
    """
    remedy = "name a file or a directory that can be read"
    if not os.path.isdir(path):  # also False for a name that is too long
        return _file_sha256(path, remedy).hex()
    files: list[Path] = []
    for folder, _, names in os.walk(path):
        try:
            files += [file for name in names if (file := Path(folder, name)).is_file()]
        except OSError as error:
            raise InputError(path, f"cannot be read ({error.strerror})", remedy) from None
        if len(files) > MOST_FILES:
            raise InputError(path, f"holds more than {MOST_FILES} files", remedy)
    digest = hashlib.sha256()
    for file in sorted(files):
        digest.update(str(file.relative_to(path)).encode(errors="surrogateescape") + b"\0")
        digest.update(_file_sha256(file, remedy))
    return digest.hexdigest()


def _file_sha256(path: Path, remedy: str) -> bytes:
    try:
        stat = path.stat()
    except (OSError, ValueError):  # `read_bytes` has a sentence for it
        return hashlib.sha256(read_bytes(path, remedy)).digest()
    return _read_sha256(path, remedy, stat.st_mtime_ns, stat.st_size)


@functools.lru_cache(maxsize=4096)
def _read_sha256(path: Path, remedy: str, mtime_ns: int, size: int) -> bytes:
    """Hash a file once; a worker that lives long reads a file again that has changed."""
    return hashlib.sha256(read_bytes(path, remedy)).digest()
