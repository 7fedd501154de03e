"""Toy link for tests that need trials, an observer, a study or a bundle in little time.

Constant curvature, one first-order lag, friction in the servo.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("HYPOTHESIS_STORAGE_DIRECTORY", "build/cache/hypothesis")  # not in the root

import casadi as ca
import hypothesis
import numpy as np
import pytest

from firmware_py.inference.manifest import Manifest, write_manifest
from models.plant.step_model import StepModel, Variable, runge_kutta
from models.shared.kinematics import base_rotation
from models.trials.trial import Trial, TrialMeta, TrialSet
from tests.compiler_options import pytest_runtest_protocol  # noqa: F401 (hook of pytest)
from tests.durations import pytest_terminal_summary  # noqa: F401 (hook of pytest)

if hypothesis.settings.default.deadline is not None:  # tests/mutation has its own settings
    hypothesis.settings.register_profile("tests", deadline=None)  # a busy machine is no failure
    hypothesis.settings.load_profile("tests")

STEP_S, PERIOD_S, REST = 0.017, 4.352, 20
OFFSET_M, LENGTH_M, WIDTH_M = 0.06, 0.95, 0.15
LINK_KG, GRAVITY_M_S2 = 0.6, 9.81
STIFFNESS_NM_RAD, LAG_S = 90.0, 0.15
TORQUE_CONSTANT_NM_A, FRICTION_A, CREEP_SPEED_RAD_S = 6.8, 0.7, 0.02


def _bent_link_m(bend_rad):
    """Markers (n, 16, 3) in the frame of the base plate, by bend (n, 2) along x and y."""
    size = np.maximum(np.linalg.norm(bend_rad, axis=1), 1e-9)
    towards = bend_rad / size[:, None]
    markers_m = np.empty((len(bend_rad), 16, 3))
    for i in range(16):
        row, corner = divmod(i, 4)
        turn = size * (row + 1) / 4
        half = WIDTH_M / 2
        offset = np.array([(half, -half)[corner % 2], (half, -half)[corner // 2]])
        along = towards @ offset  # part of the corner that lies in the plane of the bend
        radius = LENGTH_M / size
        reach = radius * (1 - np.cos(turn)) + along * (np.cos(turn) - 1)
        markers_m[:, i, :2] = offset + reach[:, None] * towards
        markers_m[:, i, 2] = OFFSET_M + radius * np.sin(turn) - along * np.sin(turn)
    return markers_m


def _toy_trial(dof, payload_kg, trial, amplitude_rad, rng, phase_2_rad=0.0, cycles=2):
    count = REST + round(cycles * PERIOD_S / STEP_S)
    moving_s = np.maximum(STEP_S * (np.arange(count) - REST), 0.0)
    omega = 2 * np.pi / PERIOD_S
    phases = np.array([0.0, phase_2_rad])[:dof]
    goal_rad = -amplitude_rad * (np.sin(omega * moving_s[:, None] + phases) - np.sin(phases))
    rate_rad_s = np.gradient(goal_rad, STEP_S, axis=0)
    weight_n = (LINK_KG + payload_kg) * GRAVITY_M_S2
    stiffness = STIFFNESS_NM_RAD * (1 + 0.02 * rng.standard_normal())
    torque_nm = weight_n * LENGTH_M * np.sin(goal_rad)
    bend_rad = np.zeros((count, 2))
    for k in range(1, count):
        target = torque_nm[k] / stiffness
        bend_rad[k, :dof] = target + np.exp(-STEP_S / LAG_S) * (bend_rad[k - 1, :dof] - target)
    friction_a = FRICTION_A * np.tanh(rate_rad_s / CREEP_SPEED_RAD_S)
    current_a = torque_nm / TORQUE_CONSTANT_NM_A + friction_a
    current_a += 0.03 * rng.standard_normal(current_a.shape)
    angle_rad = goal_rad + 1e-4 * rng.standard_normal(goal_rad.shape)
    markers_m = np.einsum("nij,nmj->nmi", base_rotation(angle_rad), _bent_link_m(bend_rad))
    markers_m += 1.5e-4 * rng.standard_normal(markers_m.shape)
    columns = {"time_s": STEP_S * np.arange(count)}
    for j in range(dof):
        columns[f"goal_{j + 1}_rad"] = goal_rad[:, j]
        columns[f"angle_{j + 1}_rad"] = angle_rad[:, j]
        columns[f"current_{j + 1}_a"] = current_a[:, j]
    tip_m = markers_m[:, 12:].mean(axis=1)
    columns |= {f"tip_{axis}_m": tip_m[:, k] for k, axis in enumerate("xyz")}
    for i in range(16):
        columns |= {f"m{i + 1:02d}_{a}_m": markers_m[:, i, k] for k, a in enumerate("xyz")}
    meta = TrialMeta(
        dof=dof, payload_kg=payload_kg, pressure_pa=41.3e3, trial=trial, motion="sinusoid",
        source="toy", period_s=PERIOD_S, amplitude_rad=float(amplitude_rad),
        phase_2_rad=float(phase_2_rad),
        base_offset_m=OFFSET_M, link_length_m=LENGTH_M, link_width_m=WIDTH_M, rest_samples=REST,
    )  # fmt: skip
    degrees = round(np.degrees(amplitude_rad))
    return Trial(f"toy_{dof}dof_{payload_kg:g}kg_{degrees}deg_{trial}", meta, columns)


def _toy_trials(
    dof, *, amplitudes_deg=(30, 20), trials=(1, 2), payloads_kg=(0.0, 1.0, 2.0), seed=0
):
    """Trial 1 and 2 at 30 degrees, trial 1 at 20 degrees."""
    rng = np.random.default_rng(seed)
    return TrialSet(
        tuple(
            _toy_trial(dof, kg, trial, np.radians(degrees), rng)
            for degrees in amplitudes_deg
            for trial in (trials if degrees == max(amplitudes_deg) else (1,))
            for kg in payloads_kg
        )
    )


def _toy_observer(dof):
    """The toy's own bend equation driven by current less friction: an observer that knows it."""
    signals = [f"{what}_{j}_{unit}" for what, unit in (("angle", "rad"), ("current", "a"))
               for j in range(1, dof + 1)]  # fmt: skip
    state_names = [f"{what}_{j}" for what in ("bend", "last", "rate") for j in range(1, dof + 1)]
    state_names += ["moment", "square"]
    x, u, p = ca.MX.sym("x", 3 * dof + 2), ca.MX.sym("u", 2 * dof), ca.MX.sym("p", 0)
    h = ca.MX.sym("h")
    bend, last, rate = x[:dof], x[dof : 2 * dof], x[2 * dof : 3 * dof]
    angle, current = u[:dof], u[dof:]
    torque = TORQUE_CONSTANT_NM_A * (current - FRICTION_A * ca.tanh(rate / CREEP_SPEED_RAD_S))
    lever = GRAVITY_M_S2 * LENGTH_M * ca.sin(angle)
    begin = ca.vertcat(bend, last, (angle - last) / h, x[3 * dof :])
    bending = ca.vertcat((torque / STIFFNESS_NM_RAD - bend) / LAG_S, ca.MX.zeros(2 * dof + 2))
    bending = ca.Function("rate", [x, u, p], [bending])
    finish = ca.vertcat(
        bend, angle, rate, x[-2] + ca.dot(torque, lever), x[-1] + ca.dot(lever, lever)
    )
    size = ca.sqrt(ca.dot(bend, bend) + 1e-18)
    radius = LENGTH_M / size
    plane = ca.vertcat(bend, ca.MX.zeros(2 - dof)) / size * radius * (1 - ca.cos(size))
    height = OFFSET_M + radius * ca.sin(size)
    q1, q2 = angle[0], angle[1] if dof > 1 else ca.MX(0)
    c1, s1, c2, s2 = ca.cos(q1), ca.sin(q1), ca.cos(q2), ca.sin(q2)
    rotation = ca.vertcat(
        ca.horzcat(c1, -s1 * s2, s1 * c2), ca.horzcat(0, c2, s2), ca.horzcat(-s1, -c1 * s2, c1 * c2)
    )
    share = 7e-4 + WIDTH_M / 2 / LENGTH_M * (ca.sum1(ca.fabs(bend)))
    outputs = ca.vertcat(
        share, rotation @ ca.vertcat(plane, height), x[-2] / (x[-1] + 1e-9) - LINK_KG
    )
    return StepModel(
        name="toy_observer",
        inputs=tuple(Variable(name, "rad" if "rad" in name else "A") for name in signals),
        parameters=(),
        states=tuple(Variable(name, "1") for name in state_names),
        outputs=tuple(Variable(name, "1") for name in ("di", "tip_x_m", "tip_y_m", "tip_z_m",
                                                       "payload_kg")),
        initial=ca.Function("initial", [u, p],
                            [ca.vertcat(ca.MX.zeros(dof), angle, ca.MX.zeros(dof + 2))]),
        begin=ca.Function("begin", [x, u, p, h], [begin]),
        flow=runge_kutta("flow", bending),
        rate=bending,
        finish=ca.Function("finish", [x, u, p, h], [finish]),
        output=ca.Function("output", [x, u, p], [outputs]),
        max_substep_s=5e-3,
    )  # fmt: skip


@pytest.fixture(scope="session")
def toy_trials():
    """Factory of toy trials: `toy_trials(dof, …)`."""
    return _toy_trials


@pytest.fixture(scope="session")
def toy_observer():
    """Factory of the toy's observer: `toy_observer(dof)`."""
    return _toy_observer


@pytest.fixture(scope="session")
def toy_fallback(toy_trials, toy_observer):
    """The paper's polynomial and the lagged regressor of the 1DOF toy."""
    from models.plant.simulation.runner import CompiledModel
    from models.predictor.fallback import fit_fallback

    return fit_fallback(toy_trials(1).split()[0], CompiledModel(toy_observer(1)))


@pytest.fixture(scope="session")
def toy_study(toy_trials, toy_fallback):
    """A study of the 1DOF toy, trial 2 and the 20 degree motion held out."""
    from models.bundle.train import name_tests
    from models.study.study import run_study

    training, held_out = toy_trials(1).split()
    return run_study(toy_fallback, name_tests(training, tuple(held_out)))


@pytest.fixture(scope="session")
def toy_bundle(toy_study, toy_fallback, tmp_path_factory):
    """The bundle of that study; copy it before changing it."""
    from models.bundle.files import write_bundle
    from models.plant.plant import read_plant

    directory = tmp_path_factory.mktemp("toy") / "bundle"
    write_bundle(directory, read_plant(), toy_fallback, study=toy_study)
    return directory


@pytest.fixture(scope="session")
def bare_bundle(tmp_path_factory):
    """Directory of a bundle of one joint that holds its manifest alone."""
    directory = tmp_path_factory.mktemp("bare_bundle")
    manifest = Manifest(
        dof=1, period_s=0.017, degree=1, estimator="none", features=(), outputs=(),
        lag_ticks=(0,), training_data_sha256="", plant_sha256="", libraries={}, metrics={},
        files={},
    )  # fmt: skip
    write_manifest(directory, manifest)
    return directory
