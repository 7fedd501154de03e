"""File of an FMI 3.0 co-simulation FMU: its variables and its binary for this machine."""

from __future__ import annotations

import ctypes
import functools
import io
import zipfile
from collections.abc import Iterable, Iterator
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Final, NamedTuple
from xml.etree import ElementTree as ET

from firmware_py.core.archive_limits import ARCHIVE_DAMAGE, check_archive
from firmware_py.core.errors import InputError
from firmware_py.inference.file_content import Source, content_of
from firmware_py.inference.fmi_platform import platform_here

__all__ = ["InstanceVariable", "open_fmu"]

_SUFFIXES: Final = {"linux": ".so", "darwin": ".dylib", "windows": ".dll"}
_FUNCTIONS: Final = (
    "fmi3InstantiateCoSimulation", "fmi3EnterInitializationMode", "fmi3ExitInitializationMode",
    "fmi3SetFloat64", "fmi3GetFloat64", "fmi3GetBoolean", "fmi3DoStep", "fmi3Reset",
    "fmi3FreeInstance",
)  # fmt: skip
"""Functions of the FMI standard that this project calls."""


class InstanceVariable(NamedTuple):
    """Scalar variable of an FMU, as its model description declares it."""

    name: str
    reference: int
    type: str
    causality: str
    unit: str  # SI unit; "1" for none
    start: float | None


def open_fmu(source: Source) -> tuple[ET.Element, dict[str, InstanceVariable], ctypes.PyDLL]:
    """Read the model description with its variables, and load the binary for this machine."""
    remedy = "copy the bundle again, or build it with 'dropstitch fmu build' in a checkout"
    path, data = content_of(source, remedy)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            check_archive(archive, path, remedy)
            root = ET.fromstring(archive.read("modelDescription.xml"))
            variables = {v.name: v for v in _variables(root)}
            name = _binary(path, root, archive.namelist())
            binary = archive.read(name)
    except (*ARCHIVE_DAMAGE, ET.ParseError) as error:
        raise InputError(path, f"is no FMU ({error})", remedy) from None
    try:
        loaded = _loaded(binary, PurePosixPath(name).name)
    except OSError as error:
        raise InputError(
            path, f"its binary does not load ({error})",
            "set TMPDIR to a directory from which programs may run, or build the FMU again",
        ) from None  # fmt: skip
    absent = [function for function in _FUNCTIONS if not hasattr(loaded, function)]
    if absent:
        raise InputError(path, f"its binary lacks {absent[0]}", remedy)
    return root, variables, loaded


@functools.lru_cache(maxsize=16)
def _loaded(binary: bytes, name: str) -> ctypes.PyDLL:
    """Load a library from bytes, cached because a process never unmaps it."""
    # Windows cannot delete a mapped file: its own clean-up removes the directory later.
    with TemporaryDirectory(prefix="dropstitch-fmu-", ignore_cleanup_errors=True) as private:
        library = Path(private) / name
        library.write_bytes(binary)
        # PyDLL keeps the interpreter's lock: a step takes microseconds, and releasing the lock
        # could cost the loop's thread a switch interval to get it back.
        return ctypes.PyDLL(str(library))  # stays mapped when the file is deleted


def _binary(path: Path, root: ET.Element, names: Iterable[str]) -> str:
    """Return the name of the binary for this machine inside the archive."""
    version = root.get("fmiVersion", "?")
    if not version.startswith("3."):
        raise InputError(path, f"is of FMI {version}", "build it with --fmi 3")
    simulation = root.find("CoSimulation")
    if simulation is None:
        raise InputError(
            path, "is not for Co-Simulation", "build it with 'dropstitch fmu build' in a checkout"
        )
    here = platform_here()
    suffix = _SUFFIXES.get(here.partition("-")[2], ".so")
    name = f"binaries/{here}/{simulation.get('modelIdentifier')}{suffix}"
    if name not in names:
        offered = sorted({n.split("/")[1] for n in names if n.startswith("binaries/")})
        raise InputError(
            path, f"holds no binary for {here}, only for {', '.join(offered) or 'none'}",
            f"build the FMU with '--platforms {here}'",
        )  # fmt: skip
    return name


def _variables(root: ET.Element) -> Iterator[InstanceVariable]:
    for element in root.findall("ModelVariables/*"):
        start = element.get("start") if element.tag == "Float64" else None
        yield InstanceVariable(
            name=element.get("name", ""),
            reference=int(element.get("valueReference", "0")),
            type=element.tag,
            causality=element.get("causality", "local"),
            unit=element.get("unit", "1"),
            start=float(start) if start else None,
        )
