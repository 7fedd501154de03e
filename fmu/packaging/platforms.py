"""Platforms of an FMU: compiler targets, folders of both standards, universal libraries for macOS.

FMI 3.0 has a folder for each platform (section 2.5.1.4). FMI 2.0 has a single folder for macOS, so
both processors share a universal library there. It has no folder for Linux on aarch64, so that
library goes to FMI 3.0's folder (docs/sources.md, "FMI").
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Final, Literal, NamedTuple

from firmware_py.core.errors import InputError
from models.shared.c_compiler import TARGETS

__all__ = ["HOST", "PLATFORMS", "SOURCE_CODE", "Platform", "binary_files", "platform_names"]

HOST: Final = "x86_64-linux"
"""Default platform of an FMU, that of the robot and the tests."""

SOURCE_CODE: Final = "c-code"
"""Name of the source code among the platforms, as FMPy calls it."""


class Platform(NamedTuple):
    """Platform of a binary."""

    target: str  # Name of the target in Zig, with the oldest supported glibc
    fmi2_folder: str
    suffix: str
    flags: tuple[str, ...] = ()  # Further options of the compiler

    def folder(self, name: str, fmi: Literal[2, 3]) -> str:
        """Return the folder under binaries/; `name` is that of the platform."""
        return self.fmi2_folder if fmi == 2 else name


_FOLDERS: Final = {
    HOST: ("linux64", ".so"),
    "aarch64-linux": ("aarch64-linux", ".so"),
    "x86_64-windows": ("win64", ".dll"),
    "x86_64-darwin": ("darwin64", ".dylib"),
    "aarch64-darwin": ("darwin64", ".dylib"),
}
"""Folder in FMI 2.0, and suffix of the library."""

PLATFORMS: Final = {name: Platform(target, *_FOLDERS[name]) for name, target in TARGETS.items()}
"""Platforms by their names in FMI 3.0, with the targets of `models.shared.c_compiler`."""


def platform_names(text: str) -> tuple[str, ...]:
    """Parse names of `PLATFORMS` and `SOURCE_CODE`, separated by commas.

    "all" stands for all of `PLATFORMS`.
    """
    known = (*PLATFORMS, SOURCE_CODE)
    parts = [part.strip() for part in text.split(",")]
    named = [name for part in parts for name in (PLATFORMS if part == "all" else [part])]
    asked = tuple(dict.fromkeys(named))
    for name in asked:
        if name not in known:
            raise InputError(
                f"--platforms {text}", f"names the unknown platform {name!r}",
                f"choose all or some of {', '.join(known)}",
            )  # fmt: skip
    return asked


def binary_files(name: str, libraries: Mapping[str, bytes], fmi: Literal[2, 3]) -> dict[str, bytes]:
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
