"""Equations of motion of point masses in generalised coordinates (Lagrange, second kind).

M(c) a + h(c, v) = tau,   M = sum m J'J,   h = sum m J'(dJ/dt v - g),   J = dr/dc
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from models.plant.scope import Expr

PointMass = tuple[Expr, Expr]
"""Mass in kg and position (3,) in m of a point."""


def rod_points(mass_kg: Expr, start_m: Expr, end_m: Expr) -> list[PointMass]:
    """Point masses with the mass, centre and inertia of a uniform slender rod (Simpson's rule).

    Parameters
    ----------
    mass_kg : SX
        Mass of the rod.
    start_m, end_m : SX, shape (3,)
        Its ends.
    """
    return [
        (mass_kg / 6, start_m),
        (mass_kg * 2 / 3, (start_m + end_m) / 2),
        (mass_kg / 6, end_m),
    ]


def lagrange_equations(
    points: Sequence[PointMass], coordinates: Expr, rates: Expr, gravity_m_s2: Expr
) -> tuple[Expr, Expr]:
    """Mass matrix and force of velocity and gravity terms.

    Parameters
    ----------
    points : sequence of (SX, SX)
        Mass and position of each point.
    coordinates, rates : SX, shape (n,)
        c and v.
    gravity_m_s2 : SX, shape (3,)
        g in the world frame.

    Returns
    -------
    mass_matrix : SX, shape (n, n)
    force : SX, shape (n,)
    """
    count = coordinates.numel()
    mass_matrix, force = ca.SX.zeros(count, count), ca.SX.zeros(count)
    for mass_kg, position_m in points:
        jacobian = ca.jacobian(position_m, coordinates)
        velocity = jacobian @ rates
        bias = ca.jtimes(velocity, coordinates, rates)
        mass_matrix += mass_kg * (jacobian.T @ jacobian)
        force += mass_kg * (jacobian.T @ (bias - gravity_m_s2))
    return mass_matrix, force


def solve_symmetric(matrix: Expr, right: Expr) -> Expr:
    """Solution of a symmetric positive definite system, by LDL decomposition.

    Parameters
    ----------
    matrix : SX, shape (n, n)
        Symmetric positive definite.
    right : SX, shape (n,)
        Right-hand side.
    """
    diagonal, upper, order = ca.ldl(matrix)
    return ca.ldl_solve(right, diagonal, upper, order)


def symbolic_base_rotation(about_y: Expr, about_minus_x: Expr) -> Expr:
    """Rotation R_y(first) R_x(-second), as `models.shared.kinematics.base_rotation`.

    Parameters
    ----------
    about_y, about_minus_x : SX
        Angles in rad.
    """
    c1, s1 = ca.cos(about_y), ca.sin(about_y)
    c2, s2 = ca.cos(about_minus_x), ca.sin(about_minus_x)
    return ca.vertcat(
        ca.horzcat(c1, -s1 * s2, s1 * c2),
        ca.horzcat(0, c2, s2),
        ca.horzcat(-s1, -c1 * s2, c1 * c2),
    )
