"""Functions with the same bits on every platform: close to the C library's, special values."""

import ctypes
import math

import numpy as np
import pytest

from fmu.fmu_builder import WRAPPER
from models.shared.c_compiler import compile_library

RANGES = {
    "sin": (1.0, 10.0, 7e5, 1e9),
    "cos": (1.0, 10.0, 7e5, 1e9),
    "exp": (1.0, 700.0, 709.0),
    "tanh": (0.2, 0.6, 1.0, 30.0),
    "erf": (0.8, 1.3, 3.0, 7.0),
}


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    path = tmp_path_factory.mktemp("math") / "fmu_math.so"
    flags = ("-fvisibility=default",)
    return ctypes.CDLL(str(compile_library([WRAPPER / "fmu_math.c"], path, flags=flags)))


@pytest.fixture(params=RANGES)
def pair(request, library):
    function = getattr(library, f"fmu_{request.param}")
    function.restype, function.argtypes = ctypes.c_double, [ctypes.c_double]
    return request.param, function, getattr(math, request.param)


def test_values_are_those_of_the_c_library_to_four_units_in_the_last_place(pair):
    """Each is within a few units of the truth; its own C library is at most 2 off."""
    name, function, expected = pair
    for limit in RANGES[name]:
        for x in np.random.default_rng(1).uniform(-limit, limit, 500).tolist():
            assert abs(function(x) - expected(x)) <= 4 * math.ulp(expected(x)), (name, x)


def test_special_values(pair):
    name, function, expected = pair
    assert math.isnan(function(math.nan))
    for x in (0.0, -0.0, 5e-324, -1e-300, 1e-12):
        assert function(x) == expected(x)
        assert math.copysign(1.0, function(x)) == math.copysign(1.0, expected(x))
    if name in ("sin", "cos"):
        assert math.isnan(function(math.inf))
    else:
        largest = {"exp": (0.0, math.inf), "tanh": (-1.0, 1.0), "erf": (-1.0, 1.0)}[name]
        assert (function(-math.inf), function(math.inf)) == largest
