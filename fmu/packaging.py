"""Content of an FMU file: binaries of each platform, source code, and a reproducible zip.

FMI 3.0 has a folder for each platform (section 2.5.1.4). FMI 2.0 has a single folder for macOS, so
both processors share a universal library there. It has no folder for Linux on aarch64, so that
library goes to FMI 3.0's folder (docs/sources.md, "FMI").
"""

from __future__ import annotations

import os
import struct
import time
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple
from xml.etree import ElementTree as ET

from firmware_py.core.errors import InputError
from firmware_py.core.output_files import replacing
from fmu.interface import FmiVersion
from models.shared.c_compiler import TARGETS

HOST: Final = "x86_64-linux"
"""Default platform of an FMU, that of the robot and the tests."""

SOURCE_CODE: Final = "c-code"
"""Name of the source code among the platforms, as FMPy calls it."""


class Platform(NamedTuple):
    target: str  # Name of the target in Zig, with the oldest supported glibc
    fmi2_folder: str
    suffix: str

    def folder(self, name: str, fmi: FmiVersion) -> str:
        """Return the folder under binaries/; `name` is that of the platform."""
        return self.fmi2_folder if fmi == 2 else name


PLATFORMS: Final = {
    name: Platform(TARGETS[name], fmi2_folder, suffix)
    for name, fmi2_folder, suffix in (
        (HOST, "linux64", ".so"),
        ("aarch64-linux", "aarch64-linux", ".so"),
        ("x86_64-windows", "win64", ".dll"),
        ("x86_64-darwin", "darwin64", ".dylib"),
        ("aarch64-darwin", "darwin64", ".dylib"),
    )
}
"""Platforms by their names in FMI 3.0."""


def platform_names(text: str) -> tuple[str, ...]:
    """Parse names of `PLATFORMS` and `SOURCE_CODE`, separated by commas.

    "all" stands for all of `PLATFORMS`.
    """
    known = (*PLATFORMS, SOURCE_CODE)
    parts = [part.strip() for part in text.split(",")]
    named = [name for part in parts for name in (PLATFORMS if part == "all" else [part])]
    for name in named:
        if name not in known:
            raise InputError(
                f"--platforms {text}", f"names the unknown platform {name!r}",
                f"choose all or some of {', '.join(known)}",
            )  # fmt: skip
    return tuple(dict.fromkeys(named))


# ---- Binaries -----------------------------------------------------------------------------------


def binary_files(name: str, libraries: Mapping[str, bytes], fmi: FmiVersion) -> dict[str, bytes]:
    """Return the libraries of all platforms by their path in the FMU."""
    places: dict[str, list[bytes]] = {}
    for key, library in libraries.items():
        platform = PLATFORMS[key]
        path = f"binaries/{platform.folder(key, fmi)}/{name}{platform.suffix}"
        places.setdefault(path, []).append(library)
    return {path: universal_library(parts) for path, parts in places.items()}


_FAT_MAGIC: Final = 0xCAFEBABE
_ALIGNMENT: Final = 14
"""Alignment of slices as a power of two: the page size of arm64."""


def universal_library(slices: Sequence[bytes]) -> bytes:
    """Join Mach-O libraries for several processors into one file; a single one is not changed.

    The file begins with a big-endian `fat_header` with one `fat_arch` for each slice (Apple,
    `mach-o/fat.h`).
    """
    if len(slices) == 1:
        return slices[0]
    step = 1 << _ALIGNMENT
    header, body, offset = [struct.pack(">II", _FAT_MAGIC, len(slices))], [], step
    for library in slices:
        processor, kind = struct.unpack_from("<II", library, 4)
        header.append(struct.pack(">5I", processor, kind, offset, len(library), _ALIGNMENT))
        padded = library + bytes(-len(library) % step)
        body.append(padded)
        offset += len(padded)
    return b"".join(header).ljust(step, b"\0") + b"".join(body)


# ---- Source code --------------------------------------------------------------------------------


def source_files(
    name: str, fmi: FmiVersion, sources: Sequence[Path], headers: Sequence[Path]
) -> dict[str, bytes]:
    """Return the files under sources/, in FMI 3.0 with their build description.

    The headers of the standard are not included, because importers have them (FMI 2.0, section 2.3;
    FMI 3.0, section 2.5.1.5).
    """
    files = {f"sources/{path.name}": path.read_bytes() for path in (*sources, *headers)}
    if fmi == 2:  # modelDescription.xml lists them
        return files
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(root, "BuildConfiguration", modelIdentifier=name)
    group = ET.SubElement(configuration, "SourceFileSet", language="C99")
    for source in sources:
        ET.SubElement(group, "SourceFile", name=source.name)
    # Without this definition CasADi's functions would be exported; importers need only FMI's.
    ET.SubElement(group, "PreprocessorDefinition", name="CASADI_SYMBOL_EXPORT", value="")
    ET.indent(root)
    text: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return files | {"sources/buildDescription.xml": text + b"\n"}


# ---- Zip ----------------------------------------------------------------------------------------

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
