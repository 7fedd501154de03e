"""Coupled nodes against textbook bodies and against the same rod cut into many points."""

import casadi as ca
import numpy as np
import pytest

from models.plant.components.lagrange import add_rod, lagrange_equations

LENGTH_M, MASS_KG, GRAVITY_M_S2 = 0.8, 1.7, 9.81


def equations(nodes_m, masses, coordinates, rates):
    gravity = ca.DM([0, 0, -GRAVITY_M_S2])
    mass, force = lagrange_equations(nodes_m, masses, coordinates, rates, ca.SX(gravity))
    return ca.Function("equations", [coordinates, rates], [mass, force])


def test_a_hanging_rod_is_the_compound_pendulum():
    angle, rate = ca.SX.sym("angle"), ca.SX.sym("rate")
    end = LENGTH_M * ca.vertcat(ca.sin(angle), 0, -ca.cos(angle))
    masses = {}
    add_rod(masses, ca.SX(MASS_KG), 0, 1)
    mass, force = equations([ca.SX.zeros(3), end], masses, angle, rate)(0.4, 2.0)
    assert float(mass) == pytest.approx(MASS_KG * LENGTH_M**2 / 3)
    assert float(force) == pytest.approx(MASS_KG * GRAVITY_M_S2 * LENGTH_M / 2 * np.sin(0.4))


def test_two_rods_and_a_mass_are_many_points():
    c, v = ca.SX.sym("c", 2), ca.SX.sym("v", 2)
    direction = [ca.vertcat(ca.cos(a), ca.sin(a) / 2, -ca.sin(a)) for a in (c[0], c[0] + c[1])]
    elbow = LENGTH_M * direction[0]
    nodes = [ca.SX.zeros(3), elbow, elbow + LENGTH_M * direction[1]]
    masses = {(2, 2): ca.SX(0.5)}
    add_rod(masses, ca.SX(MASS_KG), 0, 1)
    add_rod(masses, ca.SX(MASS_KG), 1, 2)
    count = 200
    places = (np.arange(count) + 0.5) / count
    points = [a + s * (b - a) for a, b in zip(nodes, nodes[1:], strict=False) for s in places]
    each = {(k, k): ca.SX(MASS_KG / count) for k in range(2 * count)} | {(400, 400): ca.SX(0.5)}
    found = equations(nodes, masses, c, v)([0.3, -0.7], [1.1, 0.6])
    cut = equations([*points, nodes[2]], each, c, v)([0.3, -0.7], [1.1, 0.6])
    for ours, theirs in zip(found, cut, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=2e-5)
