"""The link against mechanics worked out here: energy, modes, statics, marker geometry."""

import itertools

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import fsolve
from scipy.stats import foldnorm

from models.plant.components.link import (
    Link,
    add_rod,
    lagrange_equations,
    mean_magnitude,
    symbolic_base_rotation,
)
from models.plant.compose import apply_load_torques, declare_measured_motion
from models.plant.effects import EFFECTS, in_order
from models.plant.plant import read_plant, scope_of
from models.plant.simulation.runner import CompiledModel
from models.plant.step_model import names
from models.shared.kinematics import base_rotation

STEP_S = 0.017
LINEAR = {
    "root_limit_moment_nm": 80.0,
    **{f"{what}_{j}": 0.0 for what in ("hysteresis_share", "creep_share") for j in (1, 2)},
    **{f"directional_stiffness_{j}": 0.0 for j in (1, 2)},
}


def values(changes=()):
    plant = read_plant().with_values({**LINEAR, **dict(changes)})
    return plant, {n: q.value for n, q in plant.parameters.items()}


def place(model, changes):
    x = np.zeros(len(model.states))
    for name, value in changes.items():
        x[names(model.states).index(name)] = value
    return x


def mass_points(q, payload_kg, angle, root, span):
    """Masses and positions (n, 2) of the planar link, the span cut into fine slices."""
    length, at = q["link_length_m"], q["span_position"] * q["link_length_m"]
    along = np.append((np.arange(400) + 0.5) / 400, 1.0) * length
    first, rest = np.minimum(along, at), np.maximum(along - at, 0.0)
    positions = np.column_stack([
        q["base_offset_m"] * axis(angle) + first * axis(angle + root)
        + rest * axis(angle + root + span)
        for axis in (np.sin, np.cos)
    ])  # fmt: skip
    masses = np.append(np.full(400, q["link_mass_kg"] / 400), q["tip_mass_kg"] + payload_kg)
    return masses, positions


def potential(q, payload_kg, angle, root, span):
    """Energy of gravity and springs (the integrals of the torques)."""
    masses, positions = mass_points(q, payload_kg, angle, root, span)
    limit, k_root = q["root_limit_moment_nm"], q["root_stiffness_1_nm_rad"]
    fold = limit / (6 * q["fold_rad"] ** 5)
    return (
        q["gravity_m_s2"] * masses @ positions[:, 1]
        + limit**2 / k_root * (np.sqrt(1 + (k_root * root / limit) ** 2) - 1)
        + q["span_stiffness_1_nm_rad"] * span**2 / 2
        + fold * (root**6 + span**6)
    )


def kinetic(q, payload_kg, bends, rates, step=1e-6):
    ahead, behind = (
        mass_points(q, payload_kg, 0.0, *(np.array(bends) + sign * step * np.array(rates)))
        for sign in (1, -1)
    )
    velocity = (ahead[1] - behind[1]) / (2 * step)
    return 0.5 * ahead[0] @ np.sum(velocity**2, axis=1)


@pytest.mark.parametrize("payload_kg", [0.0, 2.0])
def test_modes_are_those_of_the_linear_equations(payload_kg):
    plant, q = values()
    model = plant.step_model(1, "driven")
    x, u = ca.MX.sym("x", len(model.states)), ca.DM([0.0, payload_kg])
    slope = ca.Function("a", [x], [ca.jacobian(model.rate(x, u, model.parameter_values()), x)])
    matrix = np.asarray(slope(place(model, {"step_s": STEP_S})))
    bends = [names(model.states).index(f"{hinge}_{what}") for what in ("bend_1_rad",
             "bend_rate_1_rad_s") for hinge in ("root", "span")]  # fmt: skip
    poles = np.linalg.eigvals(matrix[np.ix_(bends, bends)])
    mass = np.array([
        [kinetic(q, payload_kg, (0, 0), np.add(a, b)) - kinetic(q, payload_kg, (0, 0), a)
         - kinetic(q, payload_kg, (0, 0), b) for b in np.eye(2)] for a in np.eye(2)
    ])  # fmt: skip
    d = 1e-4
    stiffness = np.array([
        [sum(s * t * potential(q, payload_kg, 0.0, *(s * d * a + t * d * b))
             for s in (1, -1) for t in (1, -1)) / (4 * d * d) for b in np.eye(2)]
        for a in np.eye(2)
    ])  # fmt: skip
    damping = np.diag([q["root_damping_1_nm_s_rad"], q["span_damping_1_nm_s_rad"]])
    inverse = np.linalg.inv(mass)
    expected = np.linalg.eigvals(
        np.block([[np.zeros((2, 2)), np.eye(2)], [-inverse @ stiffness, -inverse @ damping]])
    )
    assert np.allclose(np.sort_complex(poles), np.sort_complex(expected), rtol=2e-4)
    assert 0.5 < np.abs(poles).min() / (2 * np.pi) < 6  # docs/sources.md, "The link"


@pytest.mark.parametrize(("angle", "payload_kg"), [(0.3, 0.0), (-0.5, 2.0)])
def test_sag_is_where_the_potential_is_least(angle, payload_kg):
    plant, q = values({"root_damping_1_nm_s_rad": 5.0, "span_damping_1_nm_s_rad": 5.0})
    model = plant.step_model(1, "driven")
    p, u = model.parameter_values(), np.array([angle, payload_kg])
    x = np.asarray(model.initial(u, p)).ravel()
    for _ in range(300):
        x = model.advance(x, u, p, STEP_S)
    tip = np.asarray(model.output(x, u, p)).ravel()[-3:]

    def slope(bends, d=1e-5):
        return [
            (potential(q, payload_kg, angle, *(bends + d * e))
             - potential(q, payload_kg, angle, *(bends - d * e))) / (2 * d)
            for e in np.eye(2)
        ]  # fmt: skip

    _, positions = mass_points(q, payload_kg, angle, *fsolve(slope, np.zeros(2)))
    assert np.allclose(tip[[0, 2]], positions[-1], atol=2e-5)


def test_both_planes_are_alike():
    plant, _ = values()
    one, two = plant.step_model(1, "twin"), plant.step_model(2, "twin")
    goal = 0.3 * np.sin(1.44 * STEP_S * np.arange(80))
    still, load = np.zeros(80), np.full(80, 1.0)
    alone = one.simulate(np.column_stack([goal, load]), STEP_S)
    first = two.simulate(np.column_stack([goal, still, load]), STEP_S)
    second = two.simulate(np.column_stack([still, goal, load]), STEP_S)
    assert np.allclose(alone[:, -3:], first[:, -3:], atol=1e-9)
    assert np.allclose(first[:, [-3, -1, -4]], second[:, [-2, -1, -4]], atol=1e-9)


def arc_markers(q, angle, root, span):
    """Markers (16, 3) and base corners (4, 3) of a link whose span bends like a cantilever."""
    turn = base_rotation(np.atleast_2d(angle))[0]
    section = turn @ base_rotation(np.atleast_2d(root))[0]
    half, fine = q["link_width_m"] / 2, 200
    corners = np.array([[sx * half, sy * half, 0] for sy in (1, -1) for sx in (1, -1)])

    def bent(sigma):
        return section @ base_rotation(np.atleast_2d((2 * sigma - sigma**2) * np.array(span)))[0]

    centre, rows = turn @ [0, 0, q["base_offset_m"]], []
    for k in range(4 * fine):
        centre = centre + bent((k + 0.5) / (4 * fine))[:, 2] * q["link_length_m"] / (4 * fine)
        if (k + 1) % fine == 0:
            rows.append(centre + corners @ bent((k + 1) / (4 * fine)).T)
    return np.array(rows), np.add(corners, [0, 0, q["base_offset_m"]]) @ turn.T


@pytest.mark.parametrize(
    ("root", "span"), [((0.03, 0.0), (0.04, 0.0)), ((-0.05, 0.02), (-0.03, 0.04))]
)
def test_the_index_is_that_of_markers_on_bent_edges(root, span):
    plant, q = values({"marker_noise_m": 0.0})
    model = plant.step_model(2, "twin")
    state = {f"{hinge}_bend_{j}_rad": bend[j - 1]
             for hinge, bend in (("root", root), ("span", span)) for j in (1, 2)}  # fmt: skip
    angle = np.array([0.2, -0.1])
    x = place(model, state | {"joint_1_rad": 0.2, "joint_2_rad": -0.1})
    y = np.asarray(model.output(x, [0.2, -0.1, 0.0], model.parameter_values())).ravel()
    rows, base = arc_markers(q, angle, root, span)
    lengths = np.linalg.norm(np.diff(np.concatenate([base[None], rows]), axis=0), axis=2)
    segment = q["link_length_m"] / 4
    expected = np.mean(np.abs(lengths - segment)) / segment
    assert y[names(model.outputs).index("di")] == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize(("mean", "deviation"), [(0.0, 1.0), (-2.0, 0.5)])
def test_noise_folds_as_the_folded_normal_distribution_does(mean, deviation):
    expected = foldnorm.mean(abs(mean) / deviation, scale=deviation)
    assert float(mean_magnitude(ca.DM(mean), ca.DM(deviation))) == pytest.approx(expected, rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("dof", "unit"), [(1, "twin"), (2, "twin"), (2, "observer")])
def test_the_plant_stays_finite_within_its_bounds(bench, dof, unit):
    """Also for a link that cannot carry its load and folds."""
    plant = read_plant()
    model = plant.step_model(dof, unit)
    compiled = CompiledModel(model)
    rng = np.random.default_rng(dof)
    u = bench.inputs(model, 200, payload_kg=3.0)
    for _ in range(25):
        changes = {
            v.name: rng.uniform(v.minimum, v.maximum)
            for v in model.parameters
            if plant.parameters[v.name].role != "fixed"
        }
        y = compiled.simulate(u, STEP_S, model.parameter_values(changes))
        assert np.isfinite(y).all(), changes


LENGTH_M, MASS_KG = 0.8, 1.7
OBLIQUE_M_S2 = (1.0, -2.0, -9.0)


@pytest.mark.parametrize("joints", [1, 2])
def test_two_rods_and_a_mass_move_like_many_points(joints):
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
    equations = ca.Function("ours", [c, v], ours)(*at)
    expected = ca.Function("theirs", [c, v], [mass, force])(*at)
    for a, e in zip(equations, expected, strict=True):
        np.testing.assert_allclose(a, e, rtol=1e-4, atol=1e-5)


MEMORY = {"root_limit_moment_nm": 28.9, "root_stiffness_1_nm_rad": 271.0, "creep_share_1": 0.35,
          "hysteresis_share_1": 0.3}  # fmt: skip


@pytest.fixture(scope="module")
def root_torque():
    """Function (bends of both planes, step in s) -> torque that the root takes from them.

    Viscous damping is ignored; without their planes' directional stiffness the moments are those
    of springs, creep and hysteresis.
    """
    plant = read_plant().with_values(MEMORY | {f"directional_stiffness_{j}": 0.0 for j in (1, 2)})
    load, scope = Link(), scope_of(plant.drive, plant.load, 2)
    effects = [EFFECTS[name]() for name in in_order(plant.effects)]
    scope.declare(list(plant.parameters.values()))
    declare_measured_motion(scope, effects)
    load.declare(scope)
    apply_load_torques(scope, load, effects)
    bends = ca.vertcat(*(scope.bend["root", j] for j in (1, 2)))
    rates = ca.vertcat(*(scope.bend_rate["root", j] for j in (1, 2)))
    memory = [s for n, s in scope.states.items() if n.startswith(("creep_root", "hysteresis"))]
    x, symbols = ca.vertcat(*(s.symbol for s in memory)), [s for _, s in scope.parameters.values()]
    values = {n: 0.0 if "damping" in n else q.value for n, q in plant.parameters.items()}
    p = [values[n] for n in scope.parameters]
    torque = ca.vertcat(*(-scope.bend_torque["root", j] for j in (1, 2)))
    results = [torque, ca.vertcat(*(s.rate for s in memory))]
    law = ca.Function("law", [x, bends, rates, ca.vertcat(*symbols)], results)

    def taken(path, step_s):
        state, rows = np.zeros(x.numel()), []
        rate = np.gradient(path, step_s, axis=0)
        for bend, speed in zip(path, rate, strict=True):
            torque, change = law(state, bend, speed, p)
            rows.append(np.asarray(torque).ravel())
            state = state + step_s * np.asarray(change).ravel()
        return np.array(rows)

    return taken


def test_no_fast_bend_takes_more_than_the_limit_moment(root_torque):
    step_s = 1e-4
    path = np.outer(np.linspace(0, 0.2, 500), [1.0, 0.0])  # 0.2 rad in 50 ms
    torque = np.linalg.norm(root_torque(path, step_s), axis=1)
    fold = 28.9 * 0.2**5 / 0.5**5
    assert 0.8 * 28.9 < torque.max() < 28.9 + fold


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_no_closed_path_of_the_root_yields_energy(root_torque, seed):
    """Cycles in both planes, up to far beyond the limit moment, after the memory has settled."""
    rng, step_s = np.random.default_rng(seed), 1e-3
    period_s = rng.choice([0.5, 2.0, 8.0])
    time_s = np.arange(0, 3 * period_s, step_s)
    phase = 2 * np.pi * time_s[:, None] / period_s
    amplitude, at = rng.uniform(0.01, 0.15, (3, 2)), rng.uniform(0, 2 * np.pi, (3, 2))
    path = sum(
        a * np.sin((k + 1) * phase + b) for k, (a, b) in enumerate(zip(amplitude, at, strict=True))
    )
    work = np.sum(root_torque(path, step_s) * np.gradient(path, axis=0), axis=1)
    cycle = len(time_s) // 3
    assert work[-cycle:].sum() > 0
