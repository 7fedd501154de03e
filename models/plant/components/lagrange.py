"""Equations of motion of coupled point masses on a base that turns (Lagrange, second kind).

Kinetic energy T = ½ Σ mᵢⱼ vᵢ·vⱼ of the nodes' velocities v = J ċ, with accelerations J c̈ + β::

    M(c) a + h(c, v) = tau,   M = Σ mᵢⱼ Jᵢ'Jⱼ,   h = Σ mᵢⱼ Jᵢ'(βⱼ - g)

A point mass has the entry (i, i). A uniform slender rod between two nodes has m/3 on both and m/6
between them, the consistent mass matrix of a bar (Przemieniecki, Theory of Matrix Structural
Analysis, 1968, chapter 11).

All vectors are in the frame of the base, which turns with ω. A node at r has the velocity
ω×r + ṙ and the acceleration ω̇×r + ω×(ω×r + 2ṙ) + r̈ (Goldstein, Classical Mechanics, section
4.10). That takes half the operations of world coordinates, where the rotations of the joints
multiply every term of a bend.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from models.plant.scope import Expr

Masses = Mapping[tuple[int, int], Expr]
"""Masses mᵢⱼ = mⱼᵢ in kg by pair i ≤ j of nodes; zero for a missing pair."""


def add_rod(masses: dict[tuple[int, int], Expr], mass_kg: Expr, start: int, end: int) -> None:
    """Add a uniform slender rod between two nodes."""
    for pair, fraction in (((start, start), 3), ((start, end), 6), ((end, end), 3)):
        masses[pair] = masses.get(pair, 0) + mass_kg / fraction


def lagrange_equations(
    nodes_m: Sequence[Expr],
    masses: Masses,
    joints: tuple[Sequence[Expr], Sequence[Expr]],
    bends: tuple[Expr, Expr],
    gravity_m_s2: Expr,
) -> tuple[Expr, Expr]:
    """Mass matrix (n, n) and force (n,) of velocity and gravity terms; joint angles before bends.

    `nodes_m` are the positions r (3,) of the nodes in the frame of the base, as functions of the
    bends. `joints` are angles and rates of the one or two joints (`symbolic_base_rotation`).
    """
    axes, turning, changing = _base_motion(*joints)
    weight = symbolic_base_rotation(*_both(joints[0])).T @ gravity_m_s2
    jacobians, fall = [], []
    for r in nodes_m:
        moved = ca.jtimes(r, *bends)
        jacobians.append(
            ca.horzcat(*(ca.cross(axis, r) for axis in axes), ca.jacobian(r, bends[0]))
        )
        fall.append(
            ca.cross(changing, r)
            + ca.cross(turning, ca.cross(turning, r) + 2 * moved)
            + ca.jtimes(moved, *bends)
            - weight
        )
    count = len(axes) + bends[0].numel()
    mass_matrix, force = ca.SX.zeros(count, count), ca.SX.zeros(count)
    for i, jacobian in enumerate(jacobians):
        coupled = [
            (masses[pair], j)
            for j in range(len(nodes_m))
            if (pair := (min(i, j), max(i, j))) in masses
        ]
        momentum = sum((m * jacobians[j] for m, j in coupled), start=ca.SX(3, count))
        force += jacobian.T @ sum((m * fall[j] for m, j in coupled), start=ca.SX(3, 1))
        for row in range(count):  # the matrix is symmetric
            for column in range(row + 1):
                mass_matrix[row, column] += ca.dot(jacobian[:, row], momentum[:, column])
    return ca.tril2symm(ca.tril(mass_matrix)), force


def _base_motion(angles: Sequence[Expr], rates: Sequence[Expr]) -> tuple[list[Expr], Expr, Expr]:
    """Axes of the joints, ω, and ω̇ without the joints' accelerations, in the frame of the base."""
    if len(angles) == 1:
        axis = ca.SX([0, 1, 0])
        return [axis], axis * rates[0], ca.SX(3, 1)
    c2, s2 = ca.cos(angles[1]), ca.sin(angles[1])
    axes = [ca.vertcat(0, c2, s2), ca.SX([-1, 0, 0])]
    changing = ca.vertcat(0, -s2, c2) * rates[1] * rates[0]
    return axes, axes[0] * rates[0] + axes[1] * rates[1], changing


def _both(angles: Sequence[Expr]) -> tuple[Expr, Expr]:
    return angles[0], angles[1] if len(angles) > 1 else 0


def solve_symmetric(matrix: Expr, right: Expr) -> Expr:
    """Solve a symmetric positive definite system, (n, n) and (n,), by LDL decomposition."""
    diagonal, upper, order = ca.ldl(matrix)
    return ca.ldl_solve(right, diagonal, upper, order)


def symbolic_base_rotation(about_y: Expr, about_minus_x: Expr) -> Expr:
    """Rotation R_y(first) R_x(-second), like `models.shared.kinematics.base_rotation`."""
    c1, s1 = ca.cos(about_y), ca.sin(about_y)
    c2, s2 = ca.cos(about_minus_x), ca.sin(about_minus_x)
    return ca.vertcat(
        ca.horzcat(c1, -s1 * s2, s1 * c2),
        ca.horzcat(0, c2, s2),
        ca.horzcat(-s1, -c1 * s2, c1 * c2),
    )
