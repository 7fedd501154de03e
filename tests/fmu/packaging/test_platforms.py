"""Platforms of an FMU: names, folders, libraries for macOS; a library under an emulator."""

import struct
import zipfile

import numpy as np
import pytest

from firmware_py.core.errors import InputError
from firmware_py.core.signals import PERIOD_S
from fmu.fmu_builder import build_fmu
from fmu.host.host_run import emulator_of, run_in_host
from fmu.packaging.platforms import (
    HOST,
    PLATFORMS,
    SOURCE_CODE,
    binary_files,
    platform_names,
    universal_library,
)
from models.plant.step_model import names

X86_64, ARM64, DYLIB, MACH_O = 0x01000007, 0x0100000C, 6, 0xFEEDFACF
"""Processors, file type and magic number of Mach-O (Apple, mach/machine.h, mach-o/loader.h)."""


def test_platforms_are_named_or_all():
    assert platform_names("all") == tuple(PLATFORMS)
    assert platform_names("all,c-code") == (*PLATFORMS, SOURCE_CODE)
    assert platform_names("aarch64-linux, x86_64-linux") == ("aarch64-linux", "x86_64-linux")
    with pytest.raises(InputError, match="'amiga'"):
        platform_names("x86_64-linux,amiga")


@pytest.mark.parametrize(
    ("fmi", "folders"),
    [
        (2, {"linux64", "aarch64-linux", "win64", "darwin64"}),
        (3, set(PLATFORMS)),
    ],
)
def test_each_version_has_its_folders(fmi, folders):
    fake = {name: mach_o(X86_64) for name in PLATFORMS}
    files = binary_files("link", fake, fmi)
    assert {path.split("/")[1] for path in files} == folders
    assert all(path.endswith(("/link.so", "/link.dll", "/link.dylib")) for path in files)


def mach_o(processor, size=100):
    return struct.pack("<IIII", MACH_O, processor, 3, DYLIB).ljust(size, b"\x55")


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


def _inputs(count=60):
    time_s = PERIOD_S * np.arange(count)
    return np.column_stack([2.0 * np.sin(3.0 * time_s), 0.5 + 0.5 * np.cos(time_s)])


def test_the_c_host_steps_the_library_of_this_machine(toy, toy_fmu_3, tmp_path):
    shown = [name for name in names(toy.outputs) if name != "in_range"]
    lines = run_in_host(toy_fmu_3, HOST, _inputs(), PERIOD_S, shown, tmp_path)
    rows = [names(toy.outputs).index(name) for name in shown]
    expected = toy.simulate(_inputs(), PERIOD_S)[:, rows]
    found = np.array([line.split() for line in lines], dtype=float)
    np.testing.assert_allclose(found, expected, atol=1e-12, rtol=0)


@pytest.mark.parametrize("platform", ["aarch64-linux", "x86_64-windows"])
def test_another_platform_prints_the_same_digits(toy, tmp_path, platform):
    """All 17 digits of a trajectory; qemu-user and Wine run the same C host."""
    if emulator_of(platform) is None:
        pytest.skip("needs qemu-user with libc6-arm64-cross, or Wine")
    fmu = build_fmu(toy, tmp_path / "both.fmu", platforms=(HOST, platform))
    shown = [name for name in names(toy.outputs) if name != "in_range"]
    runs = {
        name: run_in_host(fmu, name, _inputs(), PERIOD_S, shown, tmp_path)
        for name in (HOST, platform)
    }
    assert runs[platform] == runs[HOST]
    assert len(runs[HOST]) == len(_inputs()) + 1


def test_a_platform_that_cannot_run_here_or_is_not_in_the_fmu_is_refused(toy_fmu_3, tmp_path):
    with pytest.raises(InputError, match="cannot be run here"):
        run_in_host(toy_fmu_3, "aarch64-darwin", _inputs(), PERIOD_S, ["steps"], tmp_path)
    if emulator_of("aarch64-linux") is not None:
        with pytest.raises(InputError, match="no library for aarch64-linux"):
            run_in_host(toy_fmu_3, "aarch64-linux", _inputs(), PERIOD_S, ["steps"], tmp_path)


def test_an_fmu_holds_only_the_platforms_asked_for(toy_fmu_3):
    with zipfile.ZipFile(toy_fmu_3) as archive:
        binaries = [name for name in archive.namelist() if name.startswith("binaries/")]
    assert binaries == ["binaries/x86_64-linux/pendulum.so"]
