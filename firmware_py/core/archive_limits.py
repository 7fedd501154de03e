"""Limits of zip archives (FMUs, npz), checked before anything is unpacked."""

from __future__ import annotations

import lzma
import zipfile
import zlib
from pathlib import Path, PurePosixPath
from typing import Final

from firmware_py.core.errors import InputError
from firmware_py.core.units import DATA_SIZE

__all__ = ["ARCHIVE_DAMAGE", "check_archive"]

MOST_MEMBERS: Final = 1000
"""Most members of an archive; an FMU for four platforms with its sources has 60."""
MOST_UNPACKED_BYTES: Final = 100_000_000
"""Most bytes of all members, unpacked; an FMU of this project has 0.3 MB."""
MOST_TEXT_BYTES: Final = 4_000_000
"""Size of the largest XML member, unpacked; its tree takes thirty times as much memory."""
ARCHIVE_DAMAGE: Final = (
    zipfile.BadZipFile, zlib.error, lzma.LZMAError, OSError, EOFError, LookupError, RuntimeError,
    ValueError,
)  # fmt: skip
"""Errors of a damaged archive, or of XML in it that names an unknown encoding."""


def check_archive(archive: zipfile.ZipFile, path: Path, remedy: str) -> None:
    """Refuse an archive that unpacks to too many bytes, or outside its directory.

    Unpacking stops at the declared size of a member, so the declared sizes bound the allocation.
    """
    members = archive.infolist()
    names = [member.filename for member in members]
    wrong = ""
    if len(members) > MOST_MEMBERS:
        wrong = f"has {len(members)} members, more than {MOST_MEMBERS}"
    elif len(set(names)) < len(names):
        wrong = "holds two files of one name"
    elif sum(member.file_size for member in members) > MOST_UNPACKED_BYTES:
        wrong = f"unpacks to more than {DATA_SIZE.number(MOST_UNPACKED_BYTES)} MB"
    elif any(m.filename.endswith(".xml") and m.file_size > MOST_TEXT_BYTES for m in members):
        wrong = f"holds an XML file of more than {DATA_SIZE.number(MOST_TEXT_BYTES)} MB"
    else:
        astray = [n for n in names if PurePosixPath(n).is_absolute() or ".." in n.split("/")]
        wrong = f"holds a file with a path outside the archive ({astray[0]})" if astray else ""
    if wrong:
        raise InputError(path, wrong, remedy)
