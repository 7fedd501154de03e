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

from firmware_py.core.errors import InputError
from firmware_py.inference.bundle import ModelBundle
from firmware_py.inference.manifest import read_bundle_files
from fmu.documents import documentation_page, fmu_documents
from fmu.fmu_models import FmuParts, Kind, read_parts
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
from models.bundle.plant import compare_with_bundle
from models.plant.plant import Plant, read_plant
from models.plant.step_model import StepModel
from models.shared.c_compiler import compile_library
from models.shared.pages import Section

__all__ = ["build_fmu"]

ROOT: Final = Path(__file__).parents[1]
WRAPPER: Final = Path(__file__).parent / "c"
HEADERS: Final = Path(fmpy.__file__).parent / "c-code"
"""The standard's headers as FMPy ships them (BSD-2-Clause)."""


def build_fmu(
    source: ModelBundle | Plant | StepModel | Path | str,
    output: Path | str,
    *,
    kind: Kind = "twin",
    plant: Plant | Path | str | None = None,
    dof: int = 1,
    fmi: FmiVersion = 3,
    platforms: Sequence[str] = (HOST,),
    derivatives: bool = True,
    report: Callable[[str], None] = lambda text: None,
    description: str = "",
    files: Mapping[str, bytes] = MappingProxyType({}),
    sections: Sequence[Section] = (),
    example: Sequence[float] = (),
) -> Path:
    """Build an FMU from a bundle, from a plant alone, or from your step model.

    Parameters
    ----------
    source : ModelBundle, Plant, StepModel, Path or str
        Bundle or its directory; or a plant, for an FMU without a predictor; or any model.
    output : Path or str
        The .fmu file; it is replaced atomically when the FMU is complete.
    kind : {"twin", "predictor", "observer"}
        `twin`: servo and link in closed loop, driven by goals. `predictor`: the polynomial alone.
        `observer`: estimator of Deformation Index and payload. A step model has no kind.
    plant : Plant, Path or str, optional
        Plant of the FMU; by default the bundle's.
    dof : int
        Number of joints of a plant; a bundle has its own.
    fmi : {2, 3}
        Major version of FMI.
    platforms : sequence of str
        Platforms to compile for, keys of `fmu.packaging.PLATFORMS`; `SOURCE_CODE` adds the sources.
    derivatives : bool
        Whether the FMU offers directional derivatives and, in FMI 3.0, adjoint ones.
    report : callable
        Called with a phrase when the next part of the work begins.
    description, files, sections, example
        For a step model: one sentence; further files by path in the FMU; further sections of the
        documentation; amplitude of the example motion for each input (`fmu/c/fmu_example.c`).

    Returns
    -------
    Path
        The .fmu file.

    Raises
    ------
    InputError
        If the bundle or the plant cannot be read, they are of different links, or the kind needs a
        predictor and there is none.

    Examples
    --------
    >>> import dropstitch
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as directory:
    ...     path = dropstitch.build_fmu(dropstitch.read_plant(), f"{directory}/twin.fmu")
    ...     run = dropstitch.simulate_fmu(path, payload_kg=1.0)
    >>> run
    <FmuRun twin.fmu: sinusoid: 512 rows of 17 ms, 2 inputs, 6 outputs>
    """
    output = Path(output)
    if isinstance(source, StepModel):
        model = source
    else:
        parts = _parts(source, kind, dof, plant)
        report("composing the model")
        model = parts.model()
        report("simulating the reference run")
        documents = fmu_documents(parts, model, fmi)
        files, sections = documents.files | parts.resources(), documents.sections
        description, example = parts.description(), documents.example
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


def _parts(
    source: ModelBundle | Plant | Path | str, kind: Kind, dof: int, plant: Plant | Path | str | None
) -> FmuParts:
    """Parts of an FMU of a bundle, or of a plant alone."""
    if isinstance(source, Plant):
        if kind == "predictor":
            raise InputError("kind", "is predictor, and a plant has none", "give a bundle")
        return FmuParts(kind, dof, source, None)
    bundle = read_bundle_files(source.directory if isinstance(source, ModelBundle) else source)
    where: Path | str | None = None
    if plant is not None and not isinstance(plant, Plant):
        where = Path(plant)
        plant = read_plant(where)
    parts = read_parts(kind, bundle.manifest.dof, bundle.directory, plant)
    if plant is not None and parts.plant is not None:
        compare_with_bundle(parts.plant, where or f"plant {plant.name!r}", bundle, "this FMU")
    return parts


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
