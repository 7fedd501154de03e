import ctypes

import pytest

from firmware_py.errors import DropstitchError
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
