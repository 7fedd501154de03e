"""Build of an FMU: reproducible bytes, token, compiler warnings."""

import re
import zipfile
from dataclasses import replace
from datetime import UTC, datetime

import pytest

from firmware_py.core.errors import InputError
from fmu.fmu_builder import HEADERS, WRAPPER, build_fmu, core_sources
from fmu.generated_c import write_equations, write_variables
from fmu.interface import interface_of
from fmu.packaging.platforms import HOST, PLATFORMS
from models.shared.c_compiler import CACHE, compile_library

EPOCH_S = 1_790_000_000


def test_a_rebuild_gives_the_same_bytes(toy, tmp_path, monkeypatch):
    """Also when nothing is taken from the cache of compiled libraries, at another time of day."""
    monkeypatch.setenv("SOURCE_DATE_EPOCH", str(EPOCH_S))
    first = build_fmu(toy, tmp_path / "first.fmu")
    monkeypatch.setattr("models.shared.c_compiler.CACHE", tmp_path / "cache")
    monkeypatch.setattr("time.time", lambda: 0.0)
    again = build_fmu(toy, tmp_path / "again.fmu")
    assert again.read_bytes() == first.read_bytes()
    assert CACHE.parent.name == "build"


def test_an_fmu_is_dated_to_the_epoch_of_its_source_else_to_its_build(toy, tmp_path, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", str(EPOCH_S))
    assert _date(build_fmu(toy, tmp_path / "dated.fmu")) == "2026-09-21T14:13:20Z"
    monkeypatch.delenv("SOURCE_DATE_EPOCH")
    before = datetime.now(UTC).replace(microsecond=0)
    built = datetime.fromisoformat(_date(build_fmu(toy, tmp_path / "now.fmu")))
    assert before <= built <= datetime.now(UTC)
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "yesterday")
    with pytest.raises(InputError, match="is not a time"):
        build_fmu(toy, tmp_path / "never.fmu")


def _date(path):
    with zipfile.ZipFile(path) as archive:
        xml = archive.read("modelDescription.xml").decode()
    return re.search(r'generationDateAndTime="([^"]*)"', xml)[1]


def test_other_content_gets_another_token(toy, toy_fmu_3, tmp_path):
    def token(path):
        with zipfile.ZipFile(path) as archive:
            return archive.read("modelDescription.xml").split(b'instantiationToken="')[1][:38]

    heavier = replace(toy.parameters[0], start=0.9)
    other = build_fmu(
        replace(toy, parameters=(heavier, *toy.parameters[1:])), tmp_path / "other.fmu"
    )
    assert token(other) != token(toy_fmu_3)
    carrying = build_fmu(toy, tmp_path / "carrying.fmu", resources={"note.txt": b"x"})
    assert token(carrying) not in (token(other), token(toy_fmu_3))


WARNINGS = ("-Wall", "-Wextra", "-Wno-unused-parameter", "-Wvla", "-pedantic",
    "-Wno-strict-prototypes", "-Werror",
)  # fmt: skip
"""The standard fixes the parameters of each function; this FMU does not use all of them."""


@pytest.mark.parametrize("fmi", [2, 3])
def test_our_c_compiles_without_a_warning(toy, tmp_path, fmi):
    """The generated equations are CasADi's and are left out."""
    interface = interface_of(toy, "both" if fmi == 3 else "forward")
    write_equations(toy, interface, tmp_path)
    variables_c = write_variables(toy, interface, "{token}", tmp_path)
    sources = [*core_sources(fmi), variables_c]
    include = [WRAPPER, tmp_path, HEADERS]
    library = tmp_path / "without_equations.so"
    compile_library(
        sources, library, include=include, target=PLATFORMS[HOST].target, flags=WARNINGS
    )
    assert library.is_file()
