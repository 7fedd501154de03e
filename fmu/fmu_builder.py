"""Builder of FMUs: generated C, the C wrapper, one binary per platform, packed into a zip.

Two builds of the same inputs give the same bytes: the token is a hash of the content, and every
date is fixed (SOURCE_DATE_EPOCH, or 1980).
"""

from __future__ import annotations

import hashlib
import os
import time
import uuid
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, NamedTuple

import fmpy

from fmu.interface import Interface, interface_of
from fmu.model_description import FmiVersion, documentation_page, model_description_xml
from fmu.variables_c import write_variables
from models.plant.simulation.model_c import write_model_c
from models.plant.simulation.relations import Derivatives
from models.plant.step_model import StepModel
from models.shared.c_compiler import compile_library

__all__ = ["PLATFORMS", "build_fmu"]

ROOT: Final = Path(__file__).parents[1]
WRAPPER: Final = Path(__file__).parent / "c"
HEADERS: Final = Path(fmpy.__file__).parent / "c-code"
"""The standard's headers as FMPy ships them (BSD-2-Clause)."""


class Platform(NamedTuple):
    """Platform of a binary: compiler target, folders in FMI 2.0 and 3.0, suffix of the library."""

    target: str
    fmi2: str
    fmi3: str
    suffix: str


PLATFORMS: Final = {
    "x86_64-linux": Platform("x86_64-linux-gnu.2.17", "linux64", "x86_64-linux", ".so"),
}
"""Platforms that an FMU is built for."""

_EARLIEST_ZIP_S: Final = 315_532_800
"""1980-01-01, the earliest date that a zip can hold."""


def build_fmu(
    model: StepModel,
    output: Path,
    *,
    fmi: FmiVersion = 3,
    description: str = "",
    resources: Mapping[str, bytes] | None = None,
    platforms: Sequence[str] = tuple(PLATFORMS),
    derivatives: bool = True,
) -> Path:
    """Build an FMU from a step model.

    Parameters
    ----------
    model : StepModel
        Model that the FMU steps.
    output : Path
        The .fmu file; replaced atomically when it is complete.
    fmi : {2, 3}
        Version of the standard.
    description : str
        One sentence that describes the FMU.
    resources : mapping of str to bytes, optional
        Files to embed under resources/.
    platforms : sequence of str
        Keys of `PLATFORMS`.
    derivatives : bool
        Whether the FMU offers derivatives: directional ones, in FMI 3.0 adjoint ones too.

    Returns
    -------
    Path
        `output`.
    """
    resources = dict(resources or {})
    interface = interface_of(model, _offered(derivatives, fmi))
    with TemporaryDirectory(prefix="dropstitch-fmu-") as scratch:
        directory = Path(scratch)
        model_c = write_model_c(model, directory, interface.relations.functions)
        token = _token(interface, fmi, description, model_c, resources)
        variables_c = write_variables(model, interface, token, directory)
        sources = [*core_sources(fmi), model_c, variables_c]
        xml = model_description_xml(interface, fmi, token, description, _generated())
        content = {
            "modelDescription.xml": xml,
            "documentation/index.html": documentation_page(interface, description).encode(),
            "documentation/licenses/license.txt": _licences(),
            **{f"resources/{name}": data for name, data in resources.items()},
        }
        for name in platforms:
            platform = PLATFORMS[name]
            library = directory / name / f"{interface.name}{platform.suffix}"
            include = [WRAPPER, directory, HEADERS]
            compile_library(sources, library, include=include, target=platform.target)
            folder = platform.fmi2 if fmi == 2 else platform.fmi3
            content[f"binaries/{folder}/{library.name}"] = library.read_bytes()
    _pack(content, output)
    return output


def _offered(derivatives: bool, fmi: FmiVersion) -> Derivatives:
    if not derivatives:
        return "none"
    return "both" if fmi == 3 else "forward"


def core_sources(fmi: FmiVersion) -> list[Path]:
    """Return the hand-written C files of an FMU: its functions of the standard and the core.

    Parameters
    ----------
    fmi : {2, 3}
        Version of the standard.
    """
    return [WRAPPER / f"fmi{fmi}.c", *sorted(WRAPPER.glob("fmu_*.c"))]


def _token(
    interface: Interface,
    fmi: FmiVersion,
    description: str,
    model_c: Path,
    resources: Mapping[str, bytes],
) -> str:
    """A GUID that is a hash of everything that the FMU consists of."""
    digest = hashlib.sha256(model_description_xml(interface, fmi, "", description, ""))
    for path in (model_c, *sorted(WRAPPER.glob("*.[ch]"))):
        digest.update(path.read_bytes())
    for name in sorted(resources):
        digest.update(name.encode() + hashlib.sha256(resources[name]).digest())
    return f"{{{uuid.UUID(bytes=digest.digest()[:16])}}}"


def _licences() -> bytes:
    notice = (
        "This FMU is licensed as below. Its interface follows the FMI headers\n"
        "(Modelica Association Project FMI, BSD-2-Clause); its equations were written out by\n"
        "CasADi, whose template code is under MIT-0.\n\n"
    )
    return notice.encode() + (ROOT / "LICENSE").read_bytes()


def _epoch_s() -> int:
    return max(int(os.environ.get("SOURCE_DATE_EPOCH", _EARLIEST_ZIP_S)), _EARLIEST_ZIP_S)


def _generated() -> str:
    return time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(_epoch_s()))


def _pack(content: Mapping[str, bytes], output: Path) -> None:
    output.parent.mkdir(parents=True, exist_ok=True)
    scratch = output.with_name(f".{output.name}")
    date = time.gmtime(_epoch_s())[:6]
    with zipfile.ZipFile(scratch, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(content):
            entry = zipfile.ZipInfo(name, date)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.create_system = 3  # Unix, on every machine
            entry.external_attr = (0o755 if name.startswith("binaries/") else 0o644) << 16
            archive.writestr(entry, content[name])
    scratch.replace(output)
