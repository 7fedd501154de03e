"""Build of an FMU: reproducible bytes, dates, platforms, sources that compile without a warning."""

import re
import shutil
import struct
import subprocess
import zipfile
from dataclasses import replace
from datetime import UTC, datetime

import fmpy
import numpy as np
import pytest
from fmpy.build import build_platform_binary

from bench.fmu_host import emulator_of, run_in_host
from firmware_py.core.errors import InputError
from firmware_py.core.signals import PERIOD_S
from fmu.fmpy_instance import FmuArchive
from fmu.fmu_builder import HEADERS, build_fmu
from fmu.packaging import (
    HOST,
    PLATFORMS,
    SOURCE_CODE,
    binary_files,
    platform_names,
    universal_library,
)
from models.plant.step_model import names
from tests.fmu.toy import moving_inputs

EPOCH_S = 1_790_000_000
INPUTS = moving_inputs(60)
X86_64, ARM64, DYLIB, MACH_O = 0x01000007, 0x0100000C, 6, 0xFEEDFACF
"""Processors, file type and magic number of Mach-O (Apple, mach/machine.h, mach-o/loader.h)."""


def _description(path):
    with zipfile.ZipFile(path) as archive:
        return archive.read("modelDescription.xml").decode()


def test_a_rebuild_gives_the_same_bytes(toy, tmp_path, monkeypatch):
    """Also when nothing is taken from the cache of compiled libraries, at another time of day."""
    monkeypatch.setenv("SOURCE_DATE_EPOCH", str(EPOCH_S))
    first = build_fmu(toy, tmp_path / "first.fmu")
    monkeypatch.setattr("models.shared.c_compiler.CACHE", tmp_path / "cache")
    monkeypatch.setattr("time.time", lambda: 0.0)
    again = build_fmu(toy, tmp_path / "again.fmu")
    assert again.read_bytes() == first.read_bytes()
    assert 'generationDateAndTime="2026-09-21T14:13:20Z"' in _description(first)


def test_without_a_date_of_its_source_an_fmu_has_that_of_its_build(toy, tmp_path, monkeypatch):
    monkeypatch.delenv("SOURCE_DATE_EPOCH", raising=False)
    before = datetime.now(UTC).replace(microsecond=0)
    xml = _description(build_fmu(toy, tmp_path / "now.fmu"))
    built = datetime.fromisoformat(re.search(r'generationDateAndTime="([^"]*)"', xml)[1])
    assert before <= built <= datetime.now(UTC)
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "yesterday")
    with pytest.raises(InputError, match="is not a time"):
        build_fmu(toy, tmp_path / "never.fmu")


def test_other_content_gets_another_token(toy, toy_fmu_3, tmp_path):
    heavier = replace(toy.parameters[0], start=0.9)
    other = replace(toy, parameters=(heavier, *toy.parameters[1:]))
    paths = [
        toy_fmu_3, build_fmu(other, tmp_path / "other.fmu"),
        build_fmu(toy, tmp_path / "carrying.fmu", files={"resources/note.txt": b"x"}),
    ]  # fmt: skip
    tokens = [re.search(r'instantiationToken="([^"]*)"', _description(path))[1] for path in paths]
    assert len(set(tokens)) == 3


# ---- Platforms ----------------------------------------------------------------------------------


def test_platforms_are_named_or_all():
    assert platform_names("all,c-code") == (*PLATFORMS, SOURCE_CODE)
    assert platform_names("aarch64-linux, x86_64-linux") == ("aarch64-linux", "x86_64-linux")
    with pytest.raises(InputError, match="'amiga'"):
        platform_names("x86_64-linux,amiga")


def mach_o(processor, size=100):
    return struct.pack("<IIII", MACH_O, processor, 3, DYLIB).ljust(size, b"\x55")


def test_each_version_has_its_folders():
    libraries = {name: mach_o(X86_64) for name in PLATFORMS}
    folders = {
        fmi: {path.split("/")[1] for path in binary_files("link", libraries, fmi)} for fmi in (2, 3)
    }
    assert folders == {2: {"linux64", "aarch64-linux", "win64", "darwin64"}, 3: set(PLATFORMS)}


def test_a_universal_library_holds_each_slice_on_a_page_of_its_own():
    slices = [mach_o(X86_64, 20_000), mach_o(ARM64, 30_000)]
    joined = universal_library(slices)
    magic, count = struct.unpack_from(">II", joined)
    assert (magic, count) == (0xCAFEBABE, 2)
    for k, library in enumerate(slices):
        processor, _, offset, size, align = struct.unpack_from(">5I", joined, 8 + 20 * k)
        assert processor == struct.unpack_from("<I", library, 4)[0]
        assert joined[offset : offset + size] == library
        assert offset % 2**align == 0


def test_the_c_host_steps_the_library_of_this_machine(toy, toy_fmu_3, tmp_path):
    with zipfile.ZipFile(toy_fmu_3) as archive:
        binaries = [name for name in archive.namelist() if name.startswith("binaries/")]
    assert binaries == ["binaries/x86_64-linux/pendulum.so"]
    shown = [name for name in names(toy.outputs) if name != "in_range"]
    *lines, step_us = run_in_host(toy_fmu_3, HOST, INPUTS, PERIOD_S, shown, tmp_path, rounds=2)
    rows = [names(toy.outputs).index(name) for name in shown]
    expected = toy.simulate(INPUTS, PERIOD_S)[:, rows]
    values = np.array([line.split() for line in lines], dtype=float)
    np.testing.assert_allclose(values, expected, atol=1e-12, rtol=0)
    assert float(step_us) > 0
    with pytest.raises(InputError, match="cannot be run here"):
        run_in_host(toy_fmu_3, "aarch64-darwin", INPUTS, PERIOD_S, ["steps"], tmp_path)


@pytest.mark.parametrize("platform", ["aarch64-linux", "x86_64-windows"])
def test_another_platform_prints_the_same_digits(toy, toy_fmu_3, tmp_path, platform):
    """All 17 digits of a trajectory; qemu-user and Wine run the same C host."""
    if emulator_of(platform) is None:
        pytest.skip("needs qemu-user with libc6-arm64-cross, or Wine")
    fmu = build_fmu(toy, tmp_path / "both.fmu", platforms=(HOST, platform))
    shown = [name for name in names(toy.outputs) if name != "in_range"]
    here, there = (
        run_in_host(fmu, name, INPUTS, PERIOD_S, shown, tmp_path) for name in (HOST, platform)
    )
    assert there == here
    assert len(here) == len(INPUTS) + 1
    with pytest.raises(InputError, match=f"no library for {platform}"):
        run_in_host(toy_fmu_3, platform, INPUTS, PERIOD_S, shown, tmp_path)


# ---- Source code --------------------------------------------------------------------------------

STRICT = ("-Wall", "-Wextra", "-Wno-unused-parameter", "-Wvla", "-Werror")
"""The standard fixes the parameters of each function; this FMU does not use all of them. MSVC has
no arrays of variable length."""


@pytest.fixture(scope="module", params=[2, 3], ids=["fmi2", "fmi3"])
def sources(request, toy, tmp_path_factory):
    path = tmp_path_factory.mktemp("sources") / "pendulum.fmu"
    return build_fmu(toy, path, fmi=request.param, platforms=(SOURCE_CODE,))


def _listed(path):
    """C files that the FMU's description names, as FMPy reads it."""
    (configuration,) = fmpy.read_model_description(str(path)).buildConfigurations
    assert configuration.modelIdentifier == "pendulum"
    return configuration.sourceFileSets[0].sourceFiles


@pytest.mark.skipif(not shutil.which("gcc"), reason="no gcc")
def test_the_sources_are_c99_to_gcc(sources, tmp_path):
    with zipfile.ZipFile(sources) as archive:
        archive.extractall(tmp_path)
    ours = [name for name in _listed(sources) if name != "model.c"]  # model.c is CasADi's
    for files, flags in ((ours, (*STRICT, "-pedantic-errors")), (["model.c"], ())):
        paths = [str(tmp_path / "sources" / name) for name in files]
        done = subprocess.run(
            ["gcc", "-std=c99", *flags, "-fsyntax-only", f"-I{HEADERS}", *paths],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr


@pytest.mark.slow
@pytest.mark.skipif(not (shutil.which("cmake") and shutil.which("gcc")), reason="no cmake or gcc")
@pytest.mark.parametrize("sources", [3], indirect=True)
def test_fmpy_compiles_the_sources(toy, sources, tmp_path):
    """The library that FMPy's cmake makes runs as the interpreted model."""
    fmpy.extract(str(sources), str(tmp_path / "unpacked"))
    build_platform_binary(tmp_path / "unpacked", tmp_path)
    compiled = tmp_path / "compiled.fmu"
    shutil.make_archive(str(compiled), "zip", tmp_path / "unpacked")
    u = np.column_stack([np.linspace(-1.0, 1.0, 40), np.full(40, 0.5)])
    with FmuArchive(compiled.with_name("compiled.fmu.zip")) as archive, archive.instance() as unit:
        y = unit.run(names(toy.inputs), u, np.full(40, PERIOD_S), names(toy.outputs))
    np.testing.assert_allclose(y, toy.simulate(u, PERIOD_S), atol=1e-12, rtol=0)
