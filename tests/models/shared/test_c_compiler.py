import ctypes
import math
import platform

import pytest

from firmware_py.core.errors import DropstitchError, InputError
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


def test_a_library_computes_the_same_bits_with_every_option(source, tmp_path, monkeypatch):
    second = tmp_path / "second.c"
    second.write_text("double second(void) { return 2.0; }")
    for name, options in (("one", ""), ("two", "-O0")):
        monkeypatch.setenv(c_compiler.OPTIONS_VARIABLE, options)
        output = tmp_path / f"{name}.so"
        path = c_compiler.compile_library([source, second], output, at_once=name == "two")
        library = ctypes.CDLL(str(path))
        library.wave.restype, library.wave.argtypes = ctypes.c_double, [ctypes.c_double]
        assert library.wave(0.3) == 0.3 * 0.3 + math.sin(0.3), "no contraction"
        assert not hasattr(library, "hidden"), "it exports what the source marks"
    assert len(list(c_compiler.CACHE.glob("*.so"))) == 2


def test_the_cache_answers_only_for_the_same_content(source, tmp_path, monkeypatch):
    header = tmp_path / "include" / "size.h"
    header.parent.mkdir()
    header.write_text("#define SIZE 1\n")
    builds = []
    compile_ = c_compiler._compile
    monkeypatch.setattr(c_compiler, "_compile", lambda *a: (builds.append(1), compile_(*a)))

    def build(**options):
        output, include = tmp_path / "out.so", [header.parent]
        c_compiler.compile_library([source], output, include=include, **options)
        return len(builds)

    assert [build(), build()] == [1, 1]
    header.write_text("#define SIZE 2\n")
    assert build() == 2
    assert build(flags=["-O1"]) == 3
    source.write_text(SOURCE.replace("x * x", "x"))
    assert build() == 4


def test_an_error_of_the_compiler_is_passed_on(source, tmp_path):
    source.write_text("int broken( { return nonsense; }")
    with pytest.raises(DropstitchError, match=r"wave\.c:1"):
        c_compiler.compile_library([source], tmp_path / "wave.so")
    assert not (tmp_path / "wave.so").exists()


@pytest.mark.parametrize(
    ("system", "machine", "target"),
    [
        ("Linux", "aarch64", "aarch64-linux-gnu.2.17"),
        ("Darwin", "arm64", "aarch64-macos.11.0"),
        ("Windows", "AMD64", "x86_64-windows-gnu"),
        ("FreeBSD", "riscv64", None),
    ],
)
def test_a_loaded_library_is_compiled_for_this_machine(
    source, monkeypatch, system, machine, target
):
    def compile_(sources, output, include, options):
        assert options[options.index("-target") + 1] == target
        output.write_bytes(b"of another machine")

    monkeypatch.setattr(platform, "system", lambda: system)
    monkeypatch.setattr(platform, "machine", lambda: machine)
    monkeypatch.setattr(c_compiler, "_compile", compile_)
    sentence = r"holds a compiled model that does not load .*; set TMP"
    if target is None:
        sentence = r"platform riscv64-freebsd: is none that models .*; use a"
    with pytest.raises(InputError, match=sentence):
        c_compiler.load_library(lambda directory: [source])
