"""Code in lanes calculates what CasADi does, number by number."""

import ctypes

import casadi as ca
import numpy as np
import pytest

from models.plant.simulation import lanes_c
from models.plant.simulation.lanes_c import in_lanes
from models.shared.c_compiler import compile_library

LANES = 4
DRIVER = """
#include "lanes.h"
void every(const Real **arg, Real **res, int lanes);
__attribute__((visibility("default"))) void run(const double *x, double *y, int lanes) {
    Real in[3], out[COUNT];
    const Real *arg[] = {in};
    Real *res[] = {out};
    for (int i = 0; i < 3; i++)
        for (int l = 0; l < N_LANES; l++) in[i][l] = x[3 * (l < lanes ? l : lanes - 1) + i];
    every(arg, res, lanes);
    for (int i = 0; i < COUNT; i++)
        for (int l = 0; l < lanes; l++) y[COUNT * l + i] = out[i][l];
}
"""


def every_operation(x):
    a, b, c = x[0], x[1], x[2]
    return ca.vertcat(
        a + b, a - b, a * b, a / (2 + c), -a, 2 * a, a**2, 1 / (3 + b), a**3.5, ca.sqrt(c),
        ca.sin(a), ca.cos(a), ca.tan(a), ca.tanh(b), ca.exp(b), ca.log(c), ca.erf(a),
        ca.atan2(a, c), ca.fabs(a), ca.sign(a), ca.fmin(a, b), ca.fmax(a, b), ca.fmod(a, c),
        ca.floor(a),
        ca.if_else(a < b, a, c), ca.if_else(a <= b, c, b), ca.if_else(a == b, 1.5, -0.0),
        ca.if_else(ca.logic_and(a > 0, b > 0), a, b), ca.if_else(ca.logic_or(a > 0, b != 0), c, 1),
        b * ca.sin(c), b * ca.cos(c), ca.logic_not(a), ca.SX(-2.5e-13), a * ca.tanh(5 * c),
    )  # fmt: skip


@pytest.mark.parametrize("lanes", [LANES, 3])
def test_every_operation_has_the_bits_of_casadi(tmp_path, lanes):
    x = ca.SX.sym("x", 3)
    function = ca.Function("every", [x], [ca.densify(every_operation(x))])
    generator = ca.CodeGenerator("every.c", {"mex": False})
    generator.add(function)
    (tmp_path / "every.c").write_text(in_lanes(generator.dump()))
    (tmp_path / "driver.c").write_text(DRIVER)
    count = function.numel_out(0)
    path = compile_library(
        [tmp_path / "every.c", tmp_path / "driver.c"],
        tmp_path / "every.so",
        include=[tmp_path, lanes_c.LANES_H.parent],
        flags=[f"-DN_LANES={LANES}", f"-DCOUNT={count}"],
    )
    pointer = ctypes.POINTER(ctypes.c_double)
    given = np.array([[0.3, -0.2, 0.7], [-1.7, 0.0, 2.0], [0.0, 0.0, 1.0], [1e3, 1e-9, 3.5]])[
        :lanes
    ]
    result = np.empty((lanes, count))
    ctypes.CDLL(str(path)).run(given.ctypes.data_as(pointer), result.ctypes.data_as(pointer), lanes)
    expected = np.array([np.asarray(function(row)).ravel() for row in given])
    assert np.array_equal(result, expected, equal_nan=True)


def test_absent_effects_call_no_function():
    x = ca.SX.sym("x", 2)
    function = ca.Function("few", [x], [ca.vertcat(x[0] * ca.exp(x[1]), ca.exp(x[0]))])
    generator = ca.CodeGenerator("few.c", {"mex": False})
    generator.add(function)
    code = in_lanes(generator.dump())
    assert code.count("lanes_exp_times(") == 1 and code.count("lanes_exp(") == 1


def test_a_sine_and_a_cosine_of_one_angle_are_one_call():
    x = ca.SX.sym("x", 2)
    both = ca.vertcat(ca.sin(x[0]), ca.cos(x[0]), ca.sin(x[1]))
    generator = ca.CodeGenerator("both.c", {"mex": False})
    generator.add(ca.Function("both", [x], [both]))
    code = in_lanes(generator.dump())
    assert code.count("lanes_sincos(") == 1
    assert code.count("lanes_sin(") == 1 and "lanes_cos(" not in code
