"""Content of a file, read once, so that the hashed bytes are the ones in use."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Final, NamedTuple

from firmware_py.core.input_files import read_bytes

__all__ = ["FileContent", "Source", "content_of"]

LARGEST_BYTES: Final = 64_000_000
"""Size of the largest file of a bundle; the demo's files have up to 360 kB. [assumed]"""


class FileContent(NamedTuple):
    path: Path  # Origin, for messages
    data: bytes

    @property
    def sha256(self) -> str:
        return hashlib.sha256(self.data).hexdigest()


Source = Path | str | FileContent
"""A file by its path, or its content in memory."""


def content_of(source: Source, remedy: str = "copy the whole bundle directory") -> FileContent:
    """Return the content of a file, which is read unless it is in memory already.

    `remedy`: remedy in the message if the file is missing.
    """
    if isinstance(source, FileContent):
        return source
    path = Path(source)
    return FileContent(path, read_bytes(path, remedy, LARGEST_BYTES))
