"""Builder of FMUs: generated C and the C wrapper, compiled for each platform, packed into a zip.

Builds are reproducible: equal inputs and an equal SOURCE_DATE_EPOCH give equal bytes, because the
token is a hash of the contents and every date is SOURCE_DATE_EPOCH (docs/sources.md, "FMI").
Without SOURCE_DATE_EPOCH, the dates are the time of the build.
"""

from __future__ import annotations

import hashlib
import uuid
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Final

import fmpy

from fmu.documents import documentation_page
from fmu.interface import (
    FmiVersion,
    Interface,
    interface_of,
    model_description_xml,
    write_equations,
    write_variables,
)
from fmu.packaging import (
    HOST,
    PLATFORMS,
    SOURCE_CODE,
    binary_files,
    build_time_s,
    date_and_time,
    source_files,
    write_zip,
)
from fmu.relations import Derivatives
from models.plant.step_model import StepModel
from models.shared.c_compiler import compile_library
from models.shared.pages import Section

__all__ = ["build_fmu"]

ROOT: Final = Path(__file__).parents[1]
WRAPPER: Final = Path(__file__).parent / "c"
HEADERS: Final = Path(fmpy.__file__).parent / "c-code"
"""The standard's headers as FMPy ships them (BSD-2-Clause)."""


def build_fmu(
    model: StepModel,
    output: Path,
    *,
    fmi: FmiVersion = 3,
    description: str = "",
    derivatives: bool = True,
    platforms: Sequence[str] = (HOST,),
    files: Mapping[str, bytes] = MappingProxyType({}),
    sections: Sequence[Section] = (),
    example: Sequence[float] = (),
    report: Callable[[str], None] = lambda text: None,
) -> Path:
    """Build an FMU from a step model.

    Parameters
    ----------
    model : StepModel
        Model that the FMU steps.
    output : Path
        The .fmu file; it is replaced atomically when the FMU is complete.
    fmi : {2, 3}
        Major version of FMI.
    description : str
        Description in one sentence.
    derivatives : bool
        Whether the FMU offers directional derivatives and, in FMI 3.0, adjoint ones.
    platforms : sequence of str
        Platforms to compile for, keys of `fmu.packaging.PLATFORMS`; `SOURCE_CODE` adds the sources.
    files : mapping of str to bytes, optional
        Further files, by path in the FMU.
    sections : sequence of Section
        Further sections of the documentation.
    example : sequence of float
        Amplitude of the example motion for each input (`fmu/c/fmu_example.c`); empty for none.
    report : callable
        Called with a phrase when the next part of the work begins.

    Returns
    -------
    Path
        The .fmu file.
    """
    offered: Derivatives = "none" if not derivatives else "both" if fmi == 3 else "forward"
    epoch_s = build_time_s()
    report("writing the equations in C")
    interface = interface_of(model, offered, example)
    with TemporaryDirectory(prefix="dropstitch-fmu-") as scratch:
        directory = Path(scratch)
        model_c = write_equations(model, interface, directory)
        token = _token(interface, fmi, description, model_c, files)
        variables_c = write_variables(model, interface, token, directory)
        sources = [*core_sources(fmi), model_c, variables_c]
        listed = [path.name for path in sources] if SOURCE_CODE in platforms else []
        xml = model_description_xml(
            interface, fmi, token, description, date_and_time(epoch_s), listed
        )
        page = documentation_page(interface, description, sections)
        content = {
            "modelDescription.xml": xml,
            "documentation/index.html": page.encode(),
            "documentation/licenses/license.txt": _licences(),
            **files,
        }
        include = [WRAPPER, directory, HEADERS]
        if SOURCE_CODE in platforms:
            headers = [path for folder in include[:2] for path in sorted(folder.glob("*.h"))]
            content |= source_files(interface.name, fmi, sources, headers)
        libraries = {}
        for name in platforms:
            if name != SOURCE_CODE:
                report(f"compiling for {name}")
                library = directory / name / f"{interface.name}{PLATFORMS[name].suffix}"
                compile_library(sources, library, include=include, target=PLATFORMS[name].target)
                libraries[name] = library.read_bytes()
        content |= binary_files(interface.name, libraries, fmi)
    write_zip(content, output, epoch_s)
    return output


def core_sources(fmi: FmiVersion) -> list[Path]:
    """Return the hand-written C files of an FMU: the functions of the standard, and the core."""
    return [WRAPPER / f"fmi{fmi}.c", *sorted(WRAPPER.glob("fmu_*.c"))]


def _token(
    interface: Interface,
    fmi: FmiVersion,
    description: str,
    model_c: Path,
    files: Mapping[str, bytes],
) -> str:
    """GUID that is a hash of all that the FMU computes and carries under resources/."""
    digest = hashlib.sha256(model_description_xml(interface, fmi, "", description, ""))
    digest.update(repr(interface.example).encode())
    for path in (model_c, *sorted(WRAPPER.glob("*.[ch]"))):
        digest.update(path.read_bytes())
    for name in sorted(files):
        if name.startswith("resources/"):
            digest.update(name.encode() + hashlib.sha256(files[name]).digest())
    return f"{{{uuid.UUID(bytes=digest.digest()[:16])}}}"


def _licences() -> bytes:
    notice = (
        "This FMU is licensed as below. Its interface follows the FMI headers\n"
        "(Modelica Association Project FMI, BSD-2-Clause); its equations were written out by\n"
        "CasADi, whose template code is under MIT-0.\n\n"
    )
    return notice.encode() + (ROOT / "LICENSE").read_bytes()
