"""Inflatable link as a pseudo-rigid body: a root hinge and a span hinge per plane.

The root hinge is the glued patch. The span hinge stands for bending and shear of the span: under a
tip force it has the slope P L²/2EI and the deflection P L³/3EI + P L/κGA of a cantilever
(Timoshenko) at σL with σ = 1/3 − 2 EI/(κGA L²) and K = (1 − σ) 2 EI/L. Pressure adds to the shear
stiffness κGA (Le Van and Wielgosz, *Thin-Walled Structures* 43, 2005). Trials do not determine σ,
so it is fixed. Both hinges bend in two planes. Effects add creep and hysteresis to the moment m of
each (docs/sources.md, "The link")::

    m_root = K φ + creep + hysteresis,   m_span = K ψ + creep
    τ_root = m_root / √(1 + (‖m_root‖/M_c)²) + M_c φ ‖φ‖⁴/φ_f⁵ + c φ̇
    τ_span = m_span + M_c ψ ‖ψ‖⁴/φ_f⁵ + c ψ̇

The limit moment M_c bounds the whole moment of the root, because a pressurised panel collapses
where pressure no longer balances it, whatever the fabric adds: it then folds like a hinge (Thomas
and Wielgosz, *Thin-Walled Structures* 42, 2004). Air and yarns carry the viscous part [assumed].

Springs and branches of creep in parallel are a spring and Kelvin elements in series,
φ = a m + Σ b_i z_i. With F' the limit law, the energy a F(m) + Σ b_i F(z_i) grows by no more than
the work on the root, since F is convex: without hysteresis the law is passive. With it, no closed
path in the tests yields energy.

The term in φ_f is the self-contact of the folded skin. It is below 0.5 % of M_c up to φ_f/3 and
prevents a buckling link from turning over.

The Deformation Index follows from the bend. The span's bend is distributed like the slope of a
cantilever under a tip force: the fraction f(σ) = 2σ − σ² is reached at σL, so segment k between two
marker rows bends by β_k = [k = 1] φ + (f_k − f_{k−1}) ψ. An edge at (x, y) from the axis has the
strain −(x β_x + y β_y) / l_k over a segment of length l_k. The study's link has rows at L/4 … L and
edges at half its width. Markers are measured with noise n, so equation 1 of the paper averages
E|strain + n|.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import casadi as ca

from firmware_py.link.link_description import STUDY_LINK
from models.plant.components.load import PlantLoad
from models.plant.parameter import Parameter
from models.plant.scope import Expr, Hinge, Scope
from models.plant.step_model import Variable


class Link(PlantLoad):
    """Inflatable link on a base joint with one or two axes."""

    kind = "link"
    max_dof = 2
    features = ("bend", "gear load", "tip")
    hinges = ("root", "span")

    def parameters(self, scope: Scope) -> list[Parameter]:
        result = [
            Parameter("base_offset_m", "m", STUDY_LINK.base_offset_m, 0.0, 1.0,
                      "base plate above the joint axes", 'docs/sources.md, "The link": assumed'),
            Parameter("base_mass_kg", "kg", 0.5, 0.0, 10.0,
                      "mass at the base plate, where the link begins",
                      'docs/sources.md, "The link": assumed'),
            Parameter("link_length_m", "m", STUDY_LINK.length_m, 0.05, 10.0, "length of the link",
                      "paper, fig. 2"),
            Parameter("link_width_m", "m", STUDY_LINK.width_m, 0.01, 2.0, "width of the link",
                      "paper, fig. 2"),
            Parameter("gravity_m_s2", "m/s2", STUDY_LINK.gravity.size_m_s2, 0.0, 30.0,
                      f"gravity, along {_direction(scope.gravity)}", "standard gravity"),
            Parameter("link_mass_kg", "kg", 0.9, 0.5, 2.0, "mass of the link",
                      'docs/sources.md, "The link": assumed', role="nuisance",
                      prior_deviation=0.15),
            Parameter("tip_mass_kg", "kg", 0.25, 0.05, 1.0, "hardware at the tip",
                      'docs/sources.md, "The link": assumed', role="nuisance",
                      prior_deviation=0.05),
            Parameter("root_limit_moment_nm", "N.m", 22.0, 12.0, 80.0,
                      "limit moment of the root patch", 'docs/sources.md, "The link"',
                      role="nuisance"),
            Parameter("fold_rad", "rad", 0.5, 0.3, 1.0,
                      "bend at which a folded hinge takes the limit moment",
                      "assumed, far outside the study"),
            Parameter("span_position", "1", 0.184, 0.0, 0.45,
                      "span hinge from the root, fraction of length",
                      "cantilever that bends and shears: slope and deflection meet there"),
            Parameter("edge_gain", "1", 1.0, 0.3, 2.0, "edge strain per strain of a plane section",
                      "plane sections stay plane", role="calibration"),
            Parameter("marker_noise_m", "m", 0.00015, 0.0, 0.005,
                      "standard deviation of a marker coordinate", 'docs/sources.md, "The link"',
                      role="calibration"),
        ]  # fmt: skip
        for j in scope.joints:
            result += [
                Parameter(f"root_stiffness_{j}_nm_rad", "N.m/rad", 350.0, 60.0, 1000.0,
                          "stiffness of the root patch",
                          'docs/sources.md, "The link": 80 to 1000 N·m/rad', role="nuisance"),
                Parameter(f"span_stiffness_{j}_nm_rad", "N.m/rad", 232.0, 60.0, 1200.0,
                          "stiffness of the span hinge",
                          'docs/sources.md, "The link": 0.82 · 2 EI/L, EI = 135 N·m²',
                          role="nuisance"),
                Parameter(f"root_damping_{j}_nm_s_rad", "N.m.s/rad", 1.5, 0.05, 5.0,
                          "damping of the root patch",
                          'docs/sources.md, "The link": damping ratio 7 to 9 %', role="nuisance"),
                Parameter(f"span_damping_{j}_nm_s_rad", "N.m.s/rad", 0.8, 0.05, 5.0,
                          "damping of the span hinge",
                          'docs/sources.md, "The link": damping ratio 7 to 9 %', role="nuisance"),
            ]  # fmt: skip
        return result

    def declare(self, scope: Scope) -> None:
        scope.limit_moment = scope.p("root_limit_moment_nm")
        for hinge in self.hinges:
            for j in scope.joints:
                key = (hinge, j)
                bend = Variable(f"{hinge}_bend_{j}_rad", "rad", nominal=0.05)
                rate = Variable(f"{hinge}_bend_rate_{j}_rad_s", "rad/s", nominal=0.1)
                scope.bend[key], scope.bend_rate[key] = scope.state(bend), scope.state(rate)
                scope.states[bend.name].rate = scope.bend_rate[key]
                scope.stiffness[key] = scope.p(hinge + "_stiffness_{j}_nm_rad", j)

    def apply_elastic_torques(self, scope: Scope) -> None:
        for key, bend in scope.bend.items():
            scope.bend_torque[key] = -scope.stiffness[key] * bend

    def apply_limit(self, scope: Scope) -> None:
        """Bound the root's moment; add self-contact and viscous torque to each bend."""
        limit, fold_rad = scope.limit_moment, scope.p("fold_rad")
        loading = sum(scope.bend_torque["root", j] ** 2 for j in scope.joints) / limit**2
        for (hinge, j), bend in scope.bend.items():
            torque = scope.bend_torque[hinge, j]
            if hinge == "root":
                torque = torque / ca.sqrt(1 + loading)
            fold = sum(scope.bend[hinge, k] ** 2 for k in scope.joints) ** 2 / fold_rad**5
            damping = scope.p(hinge + "_damping_{j}_nm_s_rad", j)
            torque -= limit * fold * bend + damping * scope.bend_rate[hinge, j]
            scope.bend_torque[hinge, j] = torque

    def motion_equations(self, scope: Scope) -> tuple[Expr, Expr]:
        angles = [scope.angle[j] - scope.windup[j] for j in scope.joints]
        rates = [scope.rate[j] - scope.windup_rate[j] for j in scope.joints]
        return lagrange_equations(
            *self._nodes(scope),
            (angles, rates),
            (ca.vertcat(*scope.bend.values()), ca.vertcat(*scope.bend_rate.values())),
            scope.p("gravity_m_s2") * ca.vertcat(*scope.gravity),
        )

    def outputs(self, scope: Scope) -> dict[str, tuple[Variable, Expr]]:
        """Return the Deformation Index, and the end effector in the frame of the motion capture."""
        joint, bend = self._delayed(scope)
        turn_x, turn_y, turn_z = scope.frame_turn_rad
        cos, sin = ca.cos(turn_z), ca.sin(turn_z)
        about_z = ca.vertcat(ca.horzcat(cos, -sin, 0), ca.horzcat(sin, cos, 0), ca.horzcat(0, 0, 1))
        turn = symbolic_base_rotation(turn_y, -turn_x) @ about_z
        tip_m = self._frames(scope, joint, bend, scope.cross_bend)[2]
        tip_m = (1 + scope.frame_scale) * (turn @ tip_m)
        description = "Deformation Index (paper, equation 1)"
        result = {
            "di": (Variable("di", "1", 0.0, description, 0.0, nominal=0.01),
                   self._deformation_index(scope, joint, bend)),
        }  # fmt: skip
        for axis, value in zip("xyz", ca.vertsplit(tip_m), strict=True):
            name = f"tip_{axis}_m"
            result[name] = (Variable(name, "m", 0.0, f"end effector, world frame, {axis}"), value)
        return result

    def _delayed(self, scope: Scope) -> tuple[dict[int, Expr], dict[Hinge, Expr]]:
        """Joint angles and bends as the motion capture measures them, to second order in its times.

        With delay δ and low-pass T: e^(−sδ) / (1 + sT) ≈ 1 − (δ + T) s + (δ²/2 + δT + T²) s².
        """
        delay_s, lag_s = scope.frame_delay_s, scope.frame_lag_s
        curvature = delay_s**2 / 2 + lag_s * (delay_s + lag_s)

        def late(value: Expr, rate: Expr, acceleration: Expr) -> Expr:
            return value - (delay_s + lag_s) * rate + curvature * acceleration

        def derivative(rate: Expr) -> Expr:
            return scope.states[rate.name()].rate

        joint = {
            j: late(
                scope.angle[j] - scope.windup[j] + scope.lean[j],
                scope.rate[j] - scope.windup_rate[j] + scope.lean_rate[j],
                derivative(scope.rate[j])
                - scope.windup_acceleration[j]
                + scope.lean_acceleration[j],
            )
            for j in scope.joints
        }
        bend = {
            key: late(value, scope.bend_rate[key], derivative(scope.bend_rate[key]))
            for key, value in scope.bend.items()
        }
        return joint, bend

    def _frames(
        self,
        scope: Scope,
        joint: Mapping[int, Expr],
        bend: Mapping[Hinge, Expr],
        across: Mapping[str, Expr],
    ) -> tuple[Expr, Expr, Expr, Expr]:
        """Positions (3,) of root, span hinge and tip, and the rotation of the last section."""
        turns = [list(joint.values())]
        for hinge in self.hinges:
            planes = [bend[hinge, j] for j in scope.joints]
            turns.append([*planes, across[hinge]] if hinge in across else planes)
        base, first, second = (symbolic_base_rotation(*turn) for turn in turns)
        length_m, position = scope.p("link_length_m"), scope.p("span_position")
        plate_m = base @ ca.vertcat(0, 0, scope.p("base_offset_m"))
        section = base @ first
        hinge_m = plate_m + section @ ca.vertcat(0, 0, position * length_m)
        section = section @ second
        tip_m = hinge_m + section @ ca.vertcat(0, 0, (1 - position) * length_m)
        return plate_m, hinge_m, tip_m, section

    def _nodes(self, scope: Scope) -> tuple[list[Expr], dict[tuple[int, int], Expr]]:
        """Base plate, span hinge, tip and payload in the frame of the base, and the masses."""
        upright = dict.fromkeys(scope.joints, ca.SX(0))
        *nodes, section = self._frames(scope, upright, scope.bend, {})
        masses = {(0, 0): scope.p("base_mass_kg"), (2, 2): scope.p("tip_mass_kg")}
        mass_kg, position = scope.p("link_mass_kg"), scope.p("span_position")
        add_rod(masses, mass_kg * position, 0, 1)
        add_rod(masses, mass_kg * (1 - position), 1, 2)
        masses[3, 3] = scope.payload_kg  # a node by itself: an offset of zero changes no bit
        nodes.append(nodes[2] + section @ ca.vertcat(scope.payload_offset_m, 0, 0))
        return nodes, masses

    def _deformation_index(
        self, scope: Scope, joint: Mapping[int, Expr], bend: Mapping[Hinge, Expr]
    ) -> Expr:
        """Equation 1 of the paper over the segments of all edges.

        Opposite edges have equal strain, so each pair is computed once. The corners on the base
        plate are computed from the measured angle, not from the true one.
        """
        rows, edges = _edges(scope)
        total: Expr = 0
        below = 0.0
        for k, (height, segment_m) in enumerate(rows):
            # Fraction of the span's bend in this segment: the slope is 2 x - x² under a tip force.
            share = 2 * height - height**2 - (2 * below - below**2)
            below = height
            turn = [
                share * (bend["span", j] - scope.rest_bend["span", j])
                + (k == 0) * (bend["root", j] - scope.rest_bend["root", j])
                + (k == 0) * (joint[j] - scope.angle[j] - scope.ripple_since_upright(j))
                for j in scope.joints
            ]
            noisy_ends = 1 if k == 0 else 2  # the corner on the base plate has no marker
            noise = scope.p("marker_noise_m") * noisy_ends**0.5 / segment_m
            for levers, count in edges:
                levered = zip(levers, turn, strict=False)
                strain = sum(scope.p("edge_gain") * x / segment_m * t for x, t in levered)
                total += count * mean_magnitude(strain, noise)
        return total / (len(rows) * sum(count for _, count in edges))


def _direction(unit: Sequence[float]) -> str:
    """Name of the link's axis along a unit vector, or the vector's components."""
    for axis, part in zip("xyz", unit, strict=True):
        if abs(part) > 1 - 1e-9:
            return f"-{axis}" if part < 0 else axis
    return "(" + ", ".join(f"{part:.4g}" for part in unit) + ")"


def _edges(scope: Scope) -> tuple[list[tuple[float, Expr]], list[tuple[tuple[Expr, Expr], int]]]:
    """Rows and edges of the markers.

    A row is its relative height and the length of the segment below. An edge is its distances from
    the axis along x and y, and the number of edges with that strain or its negative.
    """
    if scope.layout is None:  # the study's four rows of four
        segment_m, half_m = scope.p("link_length_m") / 4, scope.p("link_width_m") / 2
        rows = [(height, segment_m) for height in (0.25, 0.5, 0.75, 1.0)]
        return rows, [((half_m, half_m), 2), ((half_m, -half_m), 2)]
    heights_m = (0.0, *scope.layout.rows_m)
    pairs: dict[tuple[float, float], int] = {}
    for x, y in scope.layout.corners_m:
        key = (-x, -y) if (-x, -y) in pairs else (x, y)
        pairs[key] = pairs.get(key, 0) + 1
    rows = [(z / heights_m[-1], z - below) for below, z in itertools.pairwise(heights_m)]
    return rows, list(pairs.items())


def mean_magnitude(mean: Expr, deviation: Expr) -> Expr:
    """E|x| of a normal x (folded normal distribution); close to |mean| if the deviation is zero."""
    deviation = ca.sqrt(deviation**2 + 1e-16)
    ratio = mean / deviation
    return mean * ca.erf(ratio / 2**0.5) + deviation * (2 / ca.pi) ** 0.5 * ca.exp(-(ratio**2) / 2)


def add_rod(masses: dict[tuple[int, int], Expr], mass_kg: Expr, start: int, end: int) -> None:
    """Add a uniform slender rod between two nodes.

    It has m/3 on both and m/6 between them, the consistent mass matrix of a bar (Przemieniecki,
    Theory of Matrix Structural Analysis, 1968, chapter 11); a point mass has the entry (i, i).
    """
    for pair, fraction in (((start, start), 3), ((start, end), 6), ((end, end), 3)):
        masses[pair] = masses.get(pair, 0) + mass_kg / fraction


def lagrange_equations(
    nodes_m: Sequence[Expr],
    masses: Mapping[tuple[int, int], Expr],
    joints: tuple[Sequence[Expr], Sequence[Expr]],
    bends: tuple[Expr, Expr],
    gravity_m_s2: Expr,
) -> tuple[Expr, Expr]:
    """Mass matrix (n, n) and force (n,) of velocity and gravity terms; joint angles before bends.

    Equations of motion of coupled point masses on a base that turns (Lagrange, second kind).
    Kinetic energy T = ½ Σ mᵢⱼ vᵢ·vⱼ of the nodes' velocities v = J ċ, with accelerations
    J c̈ + β::

        M(c) a + h(c, v) = tau,   M = Σ mᵢⱼ Jᵢ'Jⱼ,   h = Σ mᵢⱼ Jᵢ'(βⱼ - g)

    All vectors are in the frame of the base, which turns with ω. A node at r has the velocity
    ω×r + ṙ and the acceleration ω̇×r + ω×(ω×r + 2ṙ) + r̈ (Goldstein, Classical Mechanics, section
    4.10). That takes half the operations of world coordinates, where the rotations of the joints
    multiply every term of a bend.

    `nodes_m` are the positions r (3,) of the nodes in the frame of the base, as functions of the
    bends; `masses` holds mᵢⱼ = mⱼᵢ in kg by pair i ≤ j of nodes. `joints` and `bends` are their
    coordinates and rates.
    """
    axes, turning, changing = _base_motion(*joints)
    weight = symbolic_base_rotation(*joints[0]).T @ gravity_m_s2
    jacobians, fall = [], []
    for r in nodes_m:
        moved = ca.jtimes(r, *bends)
        by_joints = (ca.cross(axis, r) for axis in axes)
        jacobians.append(ca.horzcat(*by_joints, ca.jacobian(r, bends[0])))
        fall.append(
            ca.cross(changing, r)
            + ca.cross(turning, ca.cross(turning, r) + 2 * moved)
            + ca.jtimes(moved, *bends)
            - weight
        )
    count = len(axes) + bends[0].numel()
    mass_matrix, force = ca.SX.zeros(count, count), ca.SX.zeros(count)
    for i, jacobian in enumerate(jacobians):
        pairs = ((min(i, j), max(i, j)) for j in range(len(nodes_m)))
        coupled = [(masses[pair], j) for j, pair in enumerate(pairs) if pair in masses]
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


def symbolic_base_rotation(about_y: Expr, about_minus_x: Expr = 0) -> Expr:
    """Rotation R_y(first) R_x(-second), like `models.shared.kinematics.base_rotation`."""
    c1, s1 = ca.cos(about_y), ca.sin(about_y)
    c2, s2 = ca.cos(about_minus_x), ca.sin(about_minus_x)
    return ca.vertcat(
        ca.horzcat(c1, -s1 * s2, s1 * c2),
        ca.horzcat(0, c2, s2),
        ca.horzcat(-s1, -c1 * s2, c1 * c2),
    )
