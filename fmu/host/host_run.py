"""Run an FMU's library in the plain C host: on this machine, under Wine or under qemu-user.

The host prints 17 digits, so runs on two platforms can be compared bit by bit.
"""

from __future__ import annotations

import shutil
import subprocess
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.errors import DropstitchError, InputError
from fmu.fmu_builder import HEADERS
from fmu.packaging.platforms import HOST, PLATFORMS
from models.shared.c_compiler import compile_program

__all__ = ["emulator_of", "run_in_host"]

Array = NDArray[np.float64]

SOURCE: Final = Path(__file__).with_name("fmu_host.c")

_EMULATORS: Final[Mapping[str, Sequence[str]]] = {
    HOST: (),
    "x86_64-windows": ("wine",),
    "aarch64-linux": ("qemu-aarch64", "-L", "/usr/aarch64-linux-gnu"),
}
"""Command that runs a platform's programs on x86-64 Linux. The folder with the C library is that of
Debian's package libc6-arm64-cross."""


def emulator_of(platform: str) -> Sequence[str] | None:
    """Return the command that runs a platform's programs here; None if there is none."""
    command = _EMULATORS.get(platform)
    if command is None or (command and not shutil.which(command[0])):
        return None
    folders = [part for part in command if part.startswith("/")]
    return command if all(Path(folder).is_dir() for folder in folders) else None


def run_in_host(
    fmu: Path, platform: str, u: Array, step_s: float, outputs: Sequence[str], directory: Path
) -> list[str]:
    """Step an FMI 3.0 FMU in the C host; return n + 1 lines of outputs with 17 digits.

    Shapes: `u` (n, inputs). Row k drives step k; the first also serves the initialization.
    """
    emulator = emulator_of(platform)
    if emulator is None:
        raise InputError(f"platform {platform}", "cannot be run here", "install Wine or qemu-user")
    with zipfile.ZipFile(fmu) as archive:
        root = ET.fromstring(archive.read("modelDescription.xml"))
        name = root.find("CoSimulation").attrib["modelIdentifier"]  # type: ignore[union-attr]
        suffix = PLATFORMS[platform].suffix
        library = directory / f"{name}{suffix}"
        try:
            library.write_bytes(archive.read(f"binaries/{platform}/{name}{suffix}"))
        except KeyError:
            raise InputError(fmu, f"has no library for {platform}", "build it with it") from None
    program = compile_program(
        SOURCE, directory / f"fmu_host_{platform}.exe", include=[HEADERS],
        target=PLATFORMS[platform].target,
    )  # fmt: skip
    done = subprocess.run(
        [*emulator, str(program), str(library), root.attrib["instantiationToken"]],
        input=_rows(root, u, step_s, outputs), capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode:
        raise DropstitchError(f"the host refused {library.name}: {done.stderr.strip()}")
    return done.stdout.split("\n")[:-1]


def _rows(root: ET.Element[Any], u: Array, step_s: float, outputs: Sequence[str]) -> str:
    """Input of the host: references of inputs and outputs, the step size, the rows."""
    variables = root.findall("ModelVariables/*")
    inputs = [v.attrib["valueReference"] for v in variables if v.get("causality") == "input"]
    reference = {v.attrib["name"]: v.attrib["valueReference"] for v in variables}
    lines = [inputs, [reference[name] for name in outputs], [repr(step_s)]]
    lines += [[repr(float(value)) for value in row] for row in u]
    return "".join(" ".join(line) + "\n" for line in lines)
