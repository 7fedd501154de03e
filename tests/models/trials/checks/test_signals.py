"""Wrong units and conditions, doubled signals, and trials that do not go together."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.core.errors import InputError
from firmware_py.core.motion import Motion
from firmware_py.link.marker_layout import square_layout
from models.plant.plant import read_plant
from models.rig.parameters import read_parameters
from models.rig.protocol import TrialCase, run_case
from models.trials.checks.payloads import (
    judge_conditions,
    judge_payload_unit,
    payload_unit_cause,
)
from models.trials.checks.trials import check_trial, check_trials, judge_doubled, refuse_unusable
from models.trials.files import write_trial
from models.trials.trial import TrialSet
from tests.models.made_trials import rigid_trial, with_columns, with_conditions

STEP_S, REST = 0.017, 60
KG_A = 2.0
"""Current per sine of the angle and kilogram."""
SIGNALS = (("goal", "rad"), ("angle", "rad"), ("current", "a"))


def swung(payload_kg=1.0, number=1, dof=1, shown_kg=None):
    """A trial without motion capture: rest, then two periods; friction, weight and noise."""
    time_s = STEP_S * np.arange(REST + 512)
    rng = np.random.default_rng(number)
    unseen_m = np.full((len(time_s), 16, 3), np.nan)
    trial = rigid_trial(
        np.zeros((len(time_s), dof)), unseen_m, name=f"load{payload_kg:g}_{number}",
        payload_kg=payload_kg, trial=number, phase_2_rad=1.57 if dof == 2 else 0.0,
        rest_samples=REST,
    )  # fmt: skip
    for j in range(1, dof + 1):
        phase = 2 * np.pi * np.maximum(time_s - STEP_S * REST, 0) / 4.352
        goal = 0.5 * np.sin(phase) if j == 1 else 0.25 * (np.cos(phase) - 1)
        angle = np.interp(time_s - 0.03, time_s, goal) + 2e-5 * rng.standard_normal(len(time_s))
        load = KG_A * (0.7 + (payload_kg if shown_kg is None else shown_kg))
        friction = 0.5 * np.tanh(np.gradient(angle, STEP_S) / 0.05)
        noise = 0.05 * rng.standard_normal(len(time_s))
        signals = (goal, angle, friction - load * np.sin(angle) + noise)
        names = [f"{signal}_{j}_{unit}" for signal, unit in SIGNALS]
        trial.columns.update(zip(names, signals, strict=True))
    return trial


def findings(trial):
    return [(f.level, f.cause) for f in check_trial(trial).findings]


def shared(*trials, causes):
    """Findings on trials together, of some causes."""
    return [f for f in check_trials(TrialSet(trials)) if f.cause in causes]


# One trial


@pytest.mark.parametrize("dof", [1, 2])
def test_a_right_trial_has_no_findings(dof):
    assert findings(swung(dof=dof)) == []


@pytest.mark.parametrize(
    ("mistake", "level", "cause"),
    [
        (lambda t: with_columns(t, current_1_a=1e-3 * t.columns["current_1_a"]), "warning", "unit"),
        (lambda t: with_columns(t, current_2_a=t.columns["current_1_a"]), "refused", "doubled"),
        (lambda t: with_conditions(t, amplitude_rad=0.2), "warning", "amplitude"),
    ],
)
def test_a_wrong_signal_or_condition_is_named(mistake, level, cause):
    """Others are in the tests of imports."""
    assert findings(mistake(swung(dof=2)))[0] == (level, cause)


@pytest.mark.slow
def test_a_late_clock_within_one_file_is_named():
    late = run_case(read_parameters().hide({"sync_offset": 0.02}), TrialCase(Motion(), 1.0, 1, 0))
    (found,) = [f for f in check_trial(late).findings if f.cause == "clock"]
    assert "late" in found.text and "dropstitch gap" in found.remedy


# Payloads


@pytest.mark.parametrize(
    ("shown_kg", "words"),
    [
        ({}, None),
        ({(1.0, 2): 2.0}, "load1_1 and load1_2 are both of 1 kg"),
        (
            {(0.0, 1): 2.0, (0.0, 2): 2.0, (2.0, 1): 0.0, (2.0, 2): 0.0},
            "less load in the trials of",
        ),
        ({(1.0, 1): 0.2, (1.0, 2): 0.2}, "shows 0.2 kg in the trials of 1 kg"),
    ],
)
def test_payloads_that_do_not_fit_the_current_are_named(shown_kg, words):
    """One take of another payload, two payloads exchanged, one payload stated wrongly."""
    trials = [
        swung(kg, n, shown_kg=shown_kg.get((kg, n))) for kg in (0.0, 1.0, 2.0) for n in (1, 2)
    ]
    found = shared(*trials, causes=("payload",))
    assert [words in f.text for f in found] == ([True] if words else [])


@pytest.mark.parametrize(("shown_kg", "causes"), [((0, 1, 2), []), ((2, 1, 0), ["servo log"])])
def test_servo_logs_of_other_takes_are_recognised_by_the_bend(shown_kg, causes):
    """Angles of one motion are alike; the currents of two payloads are exchanged."""
    takes = []
    for kg, shown in zip((0.0, 1.0, 2.0), shown_kg, strict=True):
        trial = swung(kg, shown_kg=shown)
        tip_rad = (1.05 + 0.05 * kg) * trial.columns["angle_1_rad"]
        tip = {"tip_x_m": 1.01 * np.sin(tip_rad), "tip_z_m": 1.01 * np.cos(tip_rad)}
        takes.append(with_columns(trial, tip_y_m=0 * tip_rad, **tip))
    assert [f.cause for f in shared(*takes, causes=("servo log", "payload"))] == causes


def in_another_unit(factor):
    """Trials of 0, 1 and 2 kg whose payloads are stated in another unit."""
    return [with_conditions(swung(kg), payload_kg=factor * kg) for kg in (0.0, 1.0, 2.0)]


@pytest.mark.parametrize(
    ("factor", "servo", "cause", "words"),
    [
        (2.2046, 1.0, "payload unit", "in pounds"),
        (1e3, 1.0, "payload unit", "in grams"),
        (1.0, 2.2, "torque constant", "not the servo's"),
    ],
)
def test_current_and_plant_show_the_unit_of_the_payloads(factor, servo, cause, words):
    values = {name: q.value for name, q in read_plant().parameters.items()}
    assert judge_payload_unit(in_another_unit(1.0), values) == []
    other_servo = {"torque_constant_1_nm_a": servo * values["torque_constant_1_nm_a"]}
    (found,) = judge_payload_unit(in_another_unit(factor), values | other_servo)
    assert found.cause == cause and words in found.text


@pytest.mark.parametrize(
    ("factor", "error", "unit"),
    [
        (0.48, 0.02, "in pounds"), (1.05, 0.01, None), (0.7, 0.02, None), (0.5, 0.3, None),
        (0.11, 0.01, "in newtons"),
    ],
)  # fmt: skip
def test_a_factor_names_a_unit_only_where_one_fits_and_one_does_not(factor, error, unit):
    assert payload_unit_cause(factor, error) == unit


def test_validate_with_a_plant_names_payloads_in_pounds(tmp_path, capsys):
    for trial in in_another_unit(2.2046):
        write_trial(trial, tmp_path)
    assert main(["validate", str(tmp_path), "--plant", "models/plant/nominal.toml"]) == 0
    assert "the payloads seem to be in pounds" in capsys.readouterr().out


# Copies, pressures, joints


@pytest.mark.parametrize(
    ("sha256", "noise_rad", "count"), [("", 0.0, 1), ("a" * 64, 1e-9, 1), ("b" * 64, 1e-9, 0)]
)
def test_copies_share_their_angles_or_their_recording(sha256, noise_rad, count):
    """Angles may differ in the last digits after another import of one file."""
    once = with_conditions(swung(), recording_sha256="a" * 64)
    near = once.columns["angle_1_rad"] + noise_rad
    again = with_conditions(with_columns(once, angle_1_rad=near), recording_sha256=sha256)
    named = [replace(once, path=Path("a") / "x.csv"), replace(again, path=Path("b") / "x.csv")]
    found = judge_doubled(named)
    assert [f.cause for f in found] == ["doubled"] * count
    assert all(str(trial.path) in f.text for f in found for trial in named)


@pytest.mark.parametrize(("pressure_pa", "count"), [(42000.0, 0), (20700.0, 1)])
def test_trials_of_several_pressures_are_named(pressure_pa, count):
    trials = (swung(number=1), with_conditions(swung(number=2), pressure_pa=pressure_pa))
    found = shared(*trials, causes=("pressure",))
    assert ["20700 to 41300 Pa" in f.text for f in found] == [True] * count


@pytest.mark.parametrize(
    ("change", "named"),
    [({"link_length_m": 0.9501}, []), ({"gravity_m_s2": (0.0, 0.0, -9.80665)}, []),
     ({"link_length_m": 0.9}, ["link_length_m"]),
     ({"gravity_m_s2": (-9.81, 0.0, 0.0)}, ["gravity_m_s2"]),
     ({"markers": square_layout(0.95, 0.15, rows=3)}, ["markers"])],
)  # fmt: skip
def test_trials_of_two_links_are_named_and_a_tape_makes_no_second_link(change, named):
    first = with_conditions(swung(), link_length_m=0.95)
    differing = shared(first, with_conditions(first, **change), causes=("size",))
    assert [f.text.split()[0] for f in differing] == named


def test_joints_that_move_together_matter_to_a_predictor_only():
    trials = []
    for number in (1, 2):
        one = swung(dof=2, number=number)
        both = {f"{n}_2_{unit}": one.columns[f"{n}_1_{unit}"] for n, unit in SIGNALS}
        trials.append(with_columns(one, **both))
    (found,) = shared(*trials, causes=("joints",))
    assert found.level == "warning" and "to train a predictor" in found.remedy


# Gravity and conditions of other plants

G = 9.81
MOUNTINGS = {
    "upright": (0.0, 0.0, -G), "hanging": (0.0, 0.0, G), "horizontal": (-G, 0.0, 0.0),
    "other side": (G, 0.0, 0.0),
}  # fmt: skip


@pytest.fixture
def swing(make_trial):
    """Function (true gravity, stated gravity, period) -> a trial of one joint.

    The joint carries 1.4 kg at 0.8 m with 5 N·m per ampere: weight, inertia and friction by the
    equation of a pendulum.
    """

    def make(true, stated, period_s=4.352):
        time_s = 0.017 * np.arange(560)
        w = 2 * np.pi / period_s
        angle = -0.5 * np.sin(w * np.maximum(time_s - 0.34, 0.0))
        x, _, z = MOUNTINGS[true]
        weight_nm = 1.4 * 0.8 * (x * np.cos(angle) - z * np.sin(angle))
        inertia_nm = -1.4 * 0.8**2 * w**2 * angle
        rate = np.gradient(angle, 0.017)
        noise = 0.02 * np.random.default_rng(3).standard_normal(len(angle))
        trial = make_trial(angle, period_s=period_s, rest_samples=20, gravity_m_s2=stated)
        current = (inertia_nm - weight_nm) / 5.0 + 0.4 * np.tanh(rate / 0.05) + noise
        return with_columns(trial, current_1_a=current)

    return make


def gravity(trial):
    """Levels of the findings on gravity."""
    return [f.level for f in check_trial(trial).findings if f.cause == "gravity"]


@pytest.mark.parametrize("true", MOUNTINGS)
def test_gravity_is_compared_with_the_weight_that_the_current_holds(swing, true):
    for stated, gravity_m_s2 in MOUNTINGS.items():
        levels = [] if true == stated else ["warning"]
        assert gravity(swing(true, gravity_m_s2)) == levels, stated
    trial = swing(true, MOUNTINGS[true])
    trial.columns["current_1_a"][:] *= -1  # a wrong sign is not a wrong mounting
    assert gravity(trial) == []
    assert [f.cause for f in check_trial(trial).findings if f.cause == "current"] == ["current"]


def test_gravity_is_not_judged_by_a_fast_motion(swing):
    """At 1 s inertia outweighs gravity: a hanging link's current has an upright one's sign."""
    assert gravity(swing("hanging", MOUNTINGS["hanging"], period_s=1.0)) == []


@pytest.mark.parametrize(
    ("down_m_s2", "level"),
    [(9.78, None), (1.0, "refused"), (98.1, "refused"), (0.0, "warning"), (2.5, "warning")],
)
def test_gravity_is_that_of_the_earth_unless_a_balloon_carries_the_link(swing, down_m_s2, level):
    trial = swing("upright", (0.0, 0.0, -down_m_s2))
    assert gravity(trial) == ([level] if level else [])
    assert judge_conditions(trial, is_described=True) == []


def test_conditions_of_the_link_in_the_table_of_other_plants_are_refused(make_trial):
    trial = make_trial(0.5 * np.sin(0.05 * np.arange(200)), conditions={"payload_kg": 5.0})
    refused = [f for f in check_trial(trial).findings if f.level == "refused"]
    assert [f.cause for f in refused] == ["conditions"] and "payload_kg" in refused[0].text
    with pytest.raises(InputError, match=r"\[conditions\] names payload_kg"):
        refuse_unusable([trial])
    refuse_unusable([with_conditions(trial, link_length_m=0.0)])  # of another plant
