"""Equations of motion of coupled point masses in generalised coordinates (Lagrange, second kind).

Kinetic energy T = ½ Σ mᵢⱼ vᵢ·vⱼ of the nodes' velocities v = J ċ, with J = dr/dc::

    M(c) a + h(c, v) = tau,   M = Σ mᵢⱼ Jᵢ'Jⱼ,   h = Σ mᵢⱼ Jᵢ'(dJⱼ/dt v - g)

A point mass has the entry (i, i). A uniform slender rod between two nodes has m/3 on both and m/6
between them, the consistent mass matrix of a bar (Przemieniecki, Theory of Matrix Structural
Analysis, 1968, chapter 11).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from models.plant.scope import Expr

Masses = Mapping[tuple[int, int], Expr]
"""Mass mᵢⱼ = mⱼᵢ in kg of each pair i ≤ j of nodes that has one."""


def add_rod(masses: dict[tuple[int, int], Expr], mass_kg: Expr, start: int, end: int) -> None:
    """Add a uniform slender rod between two nodes.

    Parameters
    ----------
    masses : dict of (int, int) to SX
        Masses of the nodes, changed in place.
    mass_kg : SX
        Mass of the rod.
    start, end : int
        Nodes at its ends, start < end.
    """
    for pair, fraction in (((start, start), 3), ((start, end), 6), ((end, end), 3)):
        masses[pair] = masses.get(pair, 0) + mass_kg / fraction


def lagrange_equations(
    nodes_m: Sequence[Expr], masses: Masses, coordinates: Expr, rates: Expr, gravity_m_s2: Expr
) -> tuple[Expr, Expr]:
    """Mass matrix and force of velocity and gravity terms.

    Parameters
    ----------
    nodes_m : sequence of SX, shape (3,)
        Positions r of the nodes.
    masses : mapping of (int, int) to SX
        See `Masses`.
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
    jacobians = [ca.jacobian(r, coordinates) for r in nodes_m]
    # Twice along the motion: fewer operations than the derivative of the Jacobian.
    fall = [
        ca.jtimes(ca.jtimes(r, coordinates, rates), coordinates, rates) - gravity_m_s2
        for r in nodes_m
    ]
    mass_matrix, force = ca.SX.zeros(count, count), ca.SX.zeros(count)
    for i, jacobian in enumerate(jacobians):
        coupled = [
            (masses[pair], j)
            for j in range(len(nodes_m))
            if (pair := (min(i, j), max(i, j))) in masses
        ]
        momentum = sum((m * jacobians[j] for m, j in coupled), start=ca.SX(3, count))
        force += jacobian.T @ sum((m * fall[j] for m, j in coupled), start=ca.SX(3, 1))
        for row in range(count):  # the upper half is the lower one
            for column in range(row + 1):
                mass_matrix[row, column] += ca.dot(jacobian[:, row], momentum[:, column])
    return ca.tril2symm(ca.tril(mass_matrix)), force


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
