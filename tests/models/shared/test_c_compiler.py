import ctypes
import os
import platform

import pytest

from firmware_py.errors import DropstitchError, InputError
from models.shared import c_compiler

SOURCE = """
#include <math.h>
__attribute__((visibility("default"))) double wave(double x) { return x * x + sin(x); }
double hidden(double x) { return x; }
"""


@pytest.fixture
def source(tmp_path, monkeypatch):
    monkeypatch.setattr(c_compiler, "CACHE", tmp_path / "cache")
    path = tmp_path / "wave.c"
    path.write_text(SOURCE)
    return path


def test_a_library_computes_and_exports_what_it_marks(source, tmp_path):
    import math

    library = ctypes.CDLL(str(c_compiler.compile_library([source], tmp_path / "wave.so")))
    library.wave.restype, library.wave.argtypes = ctypes.c_double, [ctypes.c_double]
    assert library.wave(0.3) == 0.3 * 0.3 + math.sin(0.3)  # no contraction: the same bits
    assert not hasattr(library, "hidden")


def test_the_cache_answers_only_for_the_same_content(source, tmp_path, monkeypatch):
    header = tmp_path / "include" / "size.h"
    header.parent.mkdir()
    header.write_text("#define SIZE 1\n")
    builds = []
    compile_ = c_compiler._compile
    monkeypatch.setattr(c_compiler, "_compile", lambda *a: (builds.append(1), compile_(*a)))

    def build(**options):
        c_compiler.compile_library(
            [source], tmp_path / "out.so", include=[header.parent], **options
        )
        return len(builds)

    assert build() == 1
    assert build() == 1
    header.write_text("#define SIZE 2\n")
    assert build() == 2
    assert build(flags=["-O1"]) == 3
    source.write_text(SOURCE.replace("x * x", "x"))
    assert build() == 4


def test_the_compilers_complaint_is_passed_on(source, tmp_path):
    source.write_text("int broken( { return nonsense; }")
    with pytest.raises(DropstitchError, match=r"wave\.c:1"):
        c_compiler.compile_library([source], tmp_path / "wave.so")
    assert not (tmp_path / "wave.so").exists()


def test_options_of_the_environment_build_anew_and_compute_the_same(source, tmp_path, monkeypatch):
    def wave(name):
        library = ctypes.CDLL(str(c_compiler.compile_library([source], tmp_path / name)))
        library.wave.restype, library.wave.argtypes = ctypes.c_double, [ctypes.c_double]
        return library.wave(0.3)

    optimised = wave("one.so")
    monkeypatch.setenv(c_compiler.OPTIONS_VARIABLE, "-O0")
    assert wave("two.so") == optimised
    assert len(list(c_compiler.CACHE.glob("*.so"))) == 2


def on_machine(monkeypatch, system, machine):
    monkeypatch.setattr(platform, "system", lambda: system)
    monkeypatch.setattr(platform, "machine", lambda: machine)


@pytest.mark.parametrize(
    ("system", "machine", "target"),
    [
        ("Linux", "x86_64", "x86_64-linux-gnu.2.17"),
        ("Linux", "aarch64", "aarch64-linux-gnu.2.17"),
        ("Darwin", "x86_64", "x86_64-macos.11.0"),
        ("Darwin", "arm64", "aarch64-macos.11.0"),
        ("Windows", "AMD64", "x86_64-windows-gnu"),
    ],
)
def test_what_is_loaded_here_is_compiled_for_this_machine(
    source, monkeypatch, system, machine, target
):
    def compile_(sources, output, include, options):
        assert options[options.index("-target") + 1] == target
        output.write_bytes(b"of another machine")

    on_machine(monkeypatch, system, machine)
    monkeypatch.setattr(c_compiler, "_compile", compile_)
    with pytest.raises(InputError, match=r"holds a compiled model that does not load .*; set TMP"):
        c_compiler.load_library(lambda directory: [source])


def test_a_machine_without_a_target_gets_one_sentence(source, monkeypatch):
    on_machine(monkeypatch, "FreeBSD", "riscv64")
    with pytest.raises(
        InputError, match=r"platform riscv64-freebsd: is none that models .*; use a"
    ):
        c_compiler.load_library(lambda directory: [source])


def test_a_library_that_stays_mapped_may_stay_on_the_disk(source, tmp_path, monkeypatch):
    def unlink(path, **options):
        if str(path).endswith(".so"):
            raise PermissionError(13, "is mapped", str(path))
        remove(path, **options)

    remove = os.unlink
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr(c_compiler, "_compile", lambda s, output, *_: output.write_bytes(b""))
    monkeypatch.setattr(ctypes, "CDLL", lambda path: "loaded")
    c_compiler.compile_library([source], tmp_path / "cached.so")
    monkeypatch.setattr(os, "unlink", unlink)  # as on Windows
    assert c_compiler.load_library(lambda directory: [source]) == "loaded"
