"""Sources in an FMU: FMPy's list and cmake, gcc and clang as C99 without a warning."""

import shutil
import subprocess
import zipfile

import fmpy
import numpy as np
import pytest
from fmpy.build import build_platform_binary

from firmware_py.core.signals import PERIOD_S
from fmu.fmpy_instance import FmuArchive
from fmu.fmu_builder import HEADERS, build_fmu
from fmu.packaging.platforms import SOURCE_CODE
from models.plant.step_model import names

STRICT = ("-std=c99", "-pedantic-errors", "-Wall", "-Wextra", "-Wno-unused-parameter", "-Wvla")
"""C99 without extensions and without arrays of variable length, which MSVC lacks."""


@pytest.fixture(scope="module", params=[2, 3], ids=["fmi2", "fmi3"])
def sources(request, toy, tmp_path_factory):
    path = tmp_path_factory.mktemp("sources") / "pendulum.fmu"
    return build_fmu(toy, path, fmi=request.param, platforms=(SOURCE_CODE,))


def _listed(path):
    """C files that the FMU's description names, as FMPy reads it."""
    (configuration,) = fmpy.read_model_description(str(path)).buildConfigurations
    assert configuration.modelIdentifier == "pendulum"
    (group,) = configuration.sourceFileSets
    return group.sourceFiles


def test_every_source_is_there_and_no_header_of_the_standard(sources):
    with zipfile.ZipFile(sources) as archive:
        held = {name.removeprefix("sources/") for name in archive.namelist() if "sources/" in name}
    assert {name for name in held if name.endswith(".c")} == set(_listed(sources))
    assert not {path.name for path in HEADERS.glob("fmi*.h")} & held


def test_the_sources_are_c99_to_gcc(sources, tmp_path):
    """Clang as ziglang compiles them without a warning in tests/fmu/test_fmu_builder.py."""
    if shutil.which("gcc") is None:
        pytest.skip("no gcc")
    with zipfile.ZipFile(sources) as archive:
        archive.extractall(tmp_path)
    own = [name for name in _listed(sources) if name != "model.c"]  # model.c is CasADi's
    for files, flags in ((own, (*STRICT, "-Werror")), (["model.c"], ("-std=c99",))):
        paths = [str(tmp_path / "sources" / name) for name in files]
        done = subprocess.run(
            ["gcc", *flags, "-fsyntax-only", f"-I{HEADERS}", *paths],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("sources", [3], indirect=True)
def test_fmpy_compiles_the_sources(toy, sources, tmp_path):
    """The library that FMPy's cmake makes runs as the interpreted model."""
    if not shutil.which("cmake") or not shutil.which("gcc"):
        pytest.skip("no cmake or no compiler")
    fmpy.extract(str(sources), str(tmp_path / "unpacked"))
    build_platform_binary(tmp_path / "unpacked", tmp_path)
    compiled = tmp_path / "compiled.fmu"
    shutil.make_archive(str(compiled), "zip", tmp_path / "unpacked")
    u = np.column_stack([np.linspace(-1.0, 1.0, 40), np.full(40, 0.5)])
    with FmuArchive(compiled.with_name("compiled.fmu.zip")) as archive, archive.instance() as unit:
        y = unit.run(names(toy.inputs), u, np.full(40, PERIOD_S), names(toy.outputs))
    np.testing.assert_allclose(y, toy.simulate(u, PERIOD_S), atol=1e-12, rtol=0)


def test_an_fmu_without_sources_lists_none(toy_fmu):
    assert fmpy.read_model_description(str(toy_fmu)).buildConfigurations == []
    with zipfile.ZipFile(toy_fmu) as archive:
        assert not [name for name in archive.namelist() if name.startswith("sources/")]
