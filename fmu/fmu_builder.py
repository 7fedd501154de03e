"""Builder of FMUs: generated C, the C wrapper, one binary per platform, packed into a zip.

Two builds of the same inputs at the same SOURCE_DATE_EPOCH give the same bytes: the token is a
hash of the content, and every date is that one (docs/sources.md, "FMI"). Without it an FMU holds
the time of its build.
"""

from __future__ import annotations

import hashlib
import uuid
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Final

import fmpy

from fmu.generated_c import write_equations, write_variables
from fmu.interface import Interface, interface_of
from fmu.model_description import FmiVersion, model_description_xml
from fmu.packaging.documentation import documentation_page
from fmu.packaging.platforms import HOST, PLATFORMS, SOURCE_CODE, binary_files
from fmu.packaging.source_code import source_files
from fmu.packaging.zip_file import build_time_s, date_and_time, write_zip
from models.plant.simulation.relations import Derivatives
from models.plant.step_model import StepModel
from models.shared.c_compiler import compile_library
from models.shared.page_parts import Section

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
    resources: Mapping[str, bytes] = MappingProxyType({}),
    derivatives: bool = True,
    platforms: Sequence[str] = (HOST,),
    files: Mapping[str, bytes] = MappingProxyType({}),
    sections: Sequence[Section] = (),
    example: Sequence[float] = (),
) -> Path:
    """Build an FMU from a step model; returns its path.

    Parameters
    ----------
    model : StepModel
        Model that the FMU steps.
    output : Path
        The .fmu file; replaced atomically when it is complete.
    fmi : {2, 3}
        Version of the standard.
    description : str
        One sentence.
    resources : mapping of str to bytes, optional
        To embed under resources/.
    platforms : sequence of str
        Keys of `PLATFORMS`, and `SOURCE_CODE` for the sources.
    derivatives : bool
        Whether the FMU offers derivatives: directional ones, in FMI 3.0 adjoint ones too.
    files : mapping of str to bytes, optional
        Further files, by their path in the FMU.
    sections : sequence of Section
        Further sections of the documentation.
    example : sequence of float
        For each input the amplitude of the example motion (`fmu/c/fmu_example.c`); empty for none.
    """
    interface = interface_of(model, _offered(derivatives, fmi), example)
    epoch_s = build_time_s()
    with TemporaryDirectory(prefix="dropstitch-fmu-") as scratch:
        directory = Path(scratch)
        model_c = write_equations(model, interface, directory)
        token = _token(interface, fmi, description, model_c, resources)
        variables_c = write_variables(model, interface, token, directory)
        sources = [*core_sources(fmi), model_c, variables_c]
        listed = [path.name for path in sources] if SOURCE_CODE in platforms else []
        dated = date_and_time(epoch_s)
        xml = model_description_xml(interface, fmi, token, description, dated, listed)
        content = {"modelDescription.xml": xml, **files}
        content |= _documents(interface, description, resources, sections)
        include = [WRAPPER, directory, HEADERS]
        if SOURCE_CODE in platforms:
            headers = [path for folder in include[:2] for path in sorted(folder.glob("*.h"))]
            content |= source_files(interface.name, fmi, sources, headers)
        libraries = _libraries(interface.name, sources, include, platforms)
        content |= binary_files(interface.name, libraries, fmi)
    write_zip(content, output, epoch_s)
    return output


def _offered(derivatives: bool, fmi: FmiVersion) -> Derivatives:
    if not derivatives:
        return "none"
    return "both" if fmi == 3 else "forward"


def core_sources(fmi: FmiVersion) -> list[Path]:
    """Return the hand-written C files of an FMU: its functions of the standard and the core."""
    return [WRAPPER / f"fmi{fmi}.c", *sorted(WRAPPER.glob("fmu_*.c"))]


def _documents(
    interface: Interface,
    description: str,
    resources: Mapping[str, bytes],
    sections: Sequence[Section],
) -> dict[str, bytes]:
    return {
        "documentation/index.html": documentation_page(interface, description, sections).encode(),
        "documentation/licenses/license.txt": _licences(),
        **{f"resources/{name}": data for name, data in resources.items()},
    }


def _libraries(
    identifier: str, sources: Sequence[Path], include: Sequence[Path], platforms: Sequence[str]
) -> dict[str, bytes]:
    """Compiled library of each platform, by its name."""
    libraries = {}
    for name in platforms:
        if name != SOURCE_CODE:
            library = sources[-1].parent / name / f"{identifier}{PLATFORMS[name].suffix}"
            compile_library(sources, library, include=include, target=PLATFORMS[name].target)
            libraries[name] = library.read_bytes()
    return libraries


def _token(
    interface: Interface,
    fmi: FmiVersion,
    description: str,
    model_c: Path,
    resources: Mapping[str, bytes],
) -> str:
    """A GUID that is a hash of everything that the FMU consists of."""
    digest = hashlib.sha256(model_description_xml(interface, fmi, "", description, ""))
    digest.update(repr(interface.example).encode())
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
