"""Content of a file, read once: what was hashed is what is used."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Final, NamedTuple

from firmware_py.files.input_files import read_bytes

__all__ = ["FileContent", "Source", "content_of"]

LARGEST_BYTES: Final = 64_000_000
"""Largest file of a bundle; those of the demo have 360 kB at most. [assumed]"""


class FileContent(NamedTuple):
    """File in memory."""

    path: Path  # Where it was read, for messages
    data: bytes

    @property
    def sha256(self) -> str:
        """SHA-256 of the content, in hexadecimal."""
        return hashlib.sha256(self.data).hexdigest()


Source = Path | str | FileContent
"""A file by its path, or one that was read already."""


def content_of(source: Source, remedy: str = "copy the whole bundle directory") -> FileContent:
    """Return the content of a file; one that was read before is returned as it is.

    `remedy`: what the user can do where it is missing, for the message.
    """
    if isinstance(source, FileContent):
        return source
    path = Path(source)
    return FileContent(path, read_bytes(path, remedy, LARGEST_BYTES))
