"""Reproducible zip files, which depend only on their contents and one date."""

from __future__ import annotations

import os
import time
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from firmware_py.core.errors import InputError
from firmware_py.core.output_files import replacing

__all__ = ["build_time_s", "date_and_time", "write_zip"]

EPOCH_VARIABLE: Final = "SOURCE_DATE_EPOCH"
"""Environment variable with the date of a build (reproducible-builds.org)."""

_EARLIEST_ZIP_S: Final = 315_532_800
"""1980-01-01, the earliest date that a zip can hold."""


def build_time_s() -> int:
    """Return the time of the build in seconds since 1970: SOURCE_DATE_EPOCH, else now."""
    text = os.environ.get(EPOCH_VARIABLE)
    if not text:
        return int(time.time())
    try:
        return int(text)
    except ValueError:
        raise InputError(
            f"{EPOCH_VARIABLE}={text}", "is not a time", "give seconds since 1970, or unset it"
        ) from None


def date_and_time(epoch_s: int) -> str:
    """Format a time for FMI, like "2026-11-21T00:00:00Z"."""
    return time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(epoch_s))


def write_zip(content: Mapping[str, bytes], output: Path, epoch_s: int) -> None:
    """Write a zip file atomically; equal contents and time give equal bytes."""
    output.parent.mkdir(parents=True, exist_ok=True)
    date = time.gmtime(max(epoch_s, _EARLIEST_ZIP_S))[:6]
    with (
        replacing(output) as scratch,
        zipfile.ZipFile(scratch, "w", zipfile.ZIP_DEFLATED) as archive,
    ):
        for name in sorted(content):
            entry = zipfile.ZipInfo(name, date)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.create_system = 3  # Unix, on every machine
            entry.external_attr = (0o755 if name.startswith("binaries/") else 0o644) << 16
            archive.writestr(entry, content[name])
