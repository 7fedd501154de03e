"""Nodes on a base that turns, against a textbook body and many points in the world frame."""

import itertools

import casadi as ca
import numpy as np
import pytest

from models.plant.components.link import (
    add_rod,
    lagrange_equations,
    symbolic_base_rotation,
)

LENGTH_M, MASS_KG, GRAVITY_M_S2 = 0.8, 1.7, 9.81
OBLIQUE_M_S2 = (1.0, -2.0, -9.0)


def test_a_standing_rod_is_the_compound_pendulum():
    angle, rate, none = ca.SX.sym("angle"), ca.SX.sym("rate"), ca.SX(0, 1)
    nodes = [ca.SX.zeros(3), ca.SX([0, 0, LENGTH_M])]
    masses = {}
    add_rod(masses, ca.SX(MASS_KG), 0, 1)
    down = ca.SX([0, 0, -GRAVITY_M_S2])
    found = lagrange_equations(nodes, masses, ([angle], [rate]), (none, none), down)
    mass, force = ca.Function("equations", [angle, rate], found)(0.4, 2.0)
    assert float(mass) == pytest.approx(MASS_KG * LENGTH_M**2 / 3)
    assert float(force) == pytest.approx(-MASS_KG * GRAVITY_M_S2 * LENGTH_M / 2 * np.sin(0.4))


@pytest.mark.parametrize("joints", [1, 2])
def test_two_rods_and_a_mass_are_many_points_of_the_world(joints):
    c, v = ca.SX.sym("c", joints + 2), ca.SX.sym("v", joints + 2)
    b = c[joints:]
    elbow = ca.vertcat(ca.sin(b[0]) / 2, b[1] ** 2, LENGTH_M * ca.cos(b[0]))
    tip = elbow + LENGTH_M * ca.vertcat(ca.sin(b[0] + b[1]), -ca.sin(b[1]), ca.cos(b[0]))
    nodes = [ca.vertcat(0, 0, 0.1), elbow, tip]
    masses = {(2, 2): ca.SX(0.5)}
    add_rod(masses, ca.SX(MASS_KG), 0, 1)
    add_rod(masses, ca.SX(MASS_KG), 1, 2)
    ours = lagrange_equations(
        nodes, masses, (ca.vertsplit(c[:joints]), ca.vertsplit(v[:joints])), (b, v[joints:]),
        ca.SX(OBLIQUE_M_S2),
    )  # fmt: skip

    turn = symbolic_base_rotation(c[0], c[1] if joints > 1 else 0)
    mass, force, cut = 0, 0, 100
    along = [(MASS_KG / cut, p, q, (k + 0.5) / cut)
             for p, q in itertools.pairwise(nodes) for k in range(cut)]  # fmt: skip
    for m, p, q, s in [*along, (0.5, tip, tip, 0)]:
        r = turn @ (p + s * (q - p))
        jacobian = ca.jacobian(r, c)
        mass += m * jacobian.T @ jacobian
        fall = ca.jtimes(jacobian @ v, c, v) - ca.SX(OBLIQUE_M_S2)
        force += m * jacobian.T @ fall
    at = ([0.3, -0.4, 0.7, -0.2][: joints + 2], [1.1, -0.8, 0.6, 2.0][: joints + 2])
    found = ca.Function("ours", [c, v], ours)(*at)
    theirs = ca.Function("theirs", [c, v], [mass, force])(*at)
    for a, e in zip(found, theirs, strict=True):
        np.testing.assert_allclose(a, e, rtol=1e-4, atol=1e-5)
