"""Wrong units, doubled and stuck signals, wrong conditions and payloads are told by their cause."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.motion import Motion
from models.plant.plant import read_plant
from models.rig.parameters import read_parameters
from models.rig.protocol import TrialCase, run_case
from models.trials.checks.payloads import judge_payload_unit, payload_unit_cause
from models.trials.checks.trials import check_trial, check_trials, judge_doubled
from models.trials.files import write_trial
from models.trials.trial import Trial, TrialMeta, TrialSet

STEP_S, REST = 0.017, 60
KG_A = 2.0
"""Current per sine of the angle and kilogram."""
SIGNALS = (("goal", "rad"), ("angle", "rad"), ("current", "a"))


def swung(payload_kg=1.0, number=1, dof=1, shown_kg=None):
    """A trial without motion capture: rest, then two periods; friction, weight and noise."""
    meta = TrialMeta(
        dof=dof, payload_kg=payload_kg, pressure_pa=41300.0, trial=number, motion="sinusoid",
        period_s=4.352, amplitude_rad=0.5, phase_2_rad=1.57 if dof == 2 else 0.0, source="measured",
        base_offset_m=0.06, link_length_m=0.95, link_width_m=0.15, rest_samples=REST,
    )  # fmt: skip
    time_s = STEP_S * np.arange(REST + 512)
    rng = np.random.default_rng(number)
    columns = {"time_s": time_s}
    for j in range(1, dof + 1):
        phase = 2 * np.pi * np.maximum(time_s - STEP_S * REST, 0) / meta.period_s
        goal = 0.5 * np.sin(phase) if j == 1 else 0.25 * (np.cos(phase) - 1)
        angle = np.interp(time_s - 0.03, time_s, goal) + 2e-5 * rng.standard_normal(len(time_s))
        load = KG_A * (0.7 + (payload_kg if shown_kg is None else shown_kg))
        friction = 0.5 * np.tanh(np.gradient(angle, STEP_S) / 0.05)
        noise = 0.05 * rng.standard_normal(len(time_s))
        signals = (goal, angle, friction - load * np.sin(angle) + noise)
        columns |= dict(
            zip((f"goal_{j}_rad", f"angle_{j}_rad", f"current_{j}_a"), signals, strict=True)
        )
    unseen = [f"{name}_{axis}_m" for name in ("tip", *meta.layout.names) for axis in "xyz"]
    columns |= {name: np.full(len(time_s), np.nan) for name in unseen}
    return Trial(f"load{payload_kg:g}_{number}", meta, columns)


def causes(trial):
    return [(f.level, f.cause) for f in check_trial(trial).findings]


def changed(trial, **columns):
    return replace(trial, columns=trial.columns | columns)


@pytest.mark.parametrize("dof", [1, 2])
def test_a_right_trial_has_no_findings(dof):
    assert causes(swung(dof=dof)) == []


def test_units_are_told_by_the_size_of_the_signals():
    trial = swung()
    goal, angle, current = (trial.columns[n] for n in ("goal_1_rad", "angle_1_rad", "current_1_a"))
    degrees = changed(trial, goal_1_rad=np.degrees(goal), angle_1_rad=np.degrees(angle))
    assert set(causes(degrees)) == {("refused", "unit")}
    assert ("refused", "unit") in causes(changed(trial, current_1_a=1e3 * current))
    assert causes(changed(trial, current_1_a=1e-3 * current)) == [("warning", "unit")]


def test_conditions_are_compared_with_the_goals():
    trial = swung()

    def stated(**conditions):
        return causes(replace(trial, meta=msgspec.structs.replace(trial.meta, **conditions)))

    assert stated(pressure_pa=6.0) == [("refused", "pressure")]
    assert stated(period_s=2.0) == [("warning", "period")]
    assert stated(amplitude_rad=0.2) == [("warning", "amplitude")]


def test_doubled_swapped_and_stuck_signals_are_told():
    two = swung(dof=2)
    doubled = changed(two, current_2_a=two.columns["current_1_a"])
    assert ("refused", "doubled") in causes(doubled)
    columns = two.columns
    swapped = changed(two, current_1_a=columns["current_2_a"], current_2_a=columns["current_1_a"])
    assert causes(swapped) == [("warning", "current")]
    one = swung()
    held = one.columns["angle_1_rad"].copy()
    held[200:260] = held[200]
    ((level, cause),) = causes(changed(one, angle_1_rad=held))
    assert (level, cause) == ("refused", "stuck")


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
def test_payloads_that_do_not_fit_the_current_are_told(shown_kg, words):
    """One take of another payload, two payloads exchanged, one payload stated wrongly."""
    trials = [
        swung(kg, n, shown_kg=shown_kg.get((kg, n))) for kg in (0.0, 1.0, 2.0) for n in (1, 2)
    ]
    found = [f for f in check_trials(TrialSet(tuple(trials))) if f.cause == "payload"]
    assert [words in f.text for f in found] == ([True] if words else [])


PLANT_VALUES = {name: q.value for name, q in read_plant().parameters.items()}


def declared(factor):
    """Trials of 0, 1 and 2 kg whose payloads are stated in another unit."""
    trials = [swung(kg) for kg in (0.0, 1.0, 2.0)]
    metas = [msgspec.structs.replace(t.meta, payload_kg=factor * t.meta.payload_kg) for t in trials]
    return [replace(t, meta=meta) for t, meta in zip(trials, metas, strict=True)]


@pytest.mark.parametrize(
    ("factor", "unit"),
    [
        (1.0, ""), (2.2046, "in pounds"), (9.81, "in newtons"), (35.27, "in ounces"),
        (1e3, "in grams"), (1 / 2.2046, "divided by 2.2"),
    ],
)  # fmt: skip
def test_the_unit_of_the_payloads_is_told_by_the_current_and_the_plant(factor, unit):
    found = judge_payload_unit(declared(factor), PLANT_VALUES)
    assert [f.cause for f in found] == ["payload unit"] * bool(unit)
    assert all(unit in f.text for f in found)


def test_a_wrong_torque_constant_is_not_taken_for_a_unit():
    wrong = PLANT_VALUES | {"torque_constant_1_nm_a": 2.2 * 6.83}
    (found,) = judge_payload_unit(declared(1.0), wrong)
    assert found.cause == "torque constant"


@pytest.mark.parametrize(
    ("factor", "error", "unit"),
    [
        (0.48, 0.02, "in pounds"), (1.05, 0.01, None), (0.7, 0.02, None), (0.5, 0.3, None),
        (0.11, 0.01, "in newtons"),
    ],
)  # fmt: skip
def test_a_factor_names_a_unit_only_where_one_fits_and_one_does_not(factor, error, unit):
    assert payload_unit_cause(factor, error) == unit


def test_payloads_in_pounds_are_told_by_validate_with_a_plant(tmp_path, capsys):
    for trial in declared(2.2046):
        write_trial(trial, tmp_path)
    assert main(["validate", str(tmp_path), "--plant", "models/plant/nominal.toml"]) == 0
    assert "the payloads seem to be in pounds" in capsys.readouterr().out


def test_servo_logs_of_other_takes_are_told_by_the_bend():
    """Angles of one motion are alike; the currents of two payloads are exchanged."""

    def taken(kg, shown_kg):
        trial = swung(kg, shown_kg=shown_kg)
        tip_rad = (1.05 + 0.05 * kg) * trial.columns["angle_1_rad"]
        return changed(trial, tip_x_m=1.01 * np.sin(tip_rad), tip_y_m=0 * tip_rad,
                       tip_z_m=1.01 * np.cos(tip_rad))  # fmt: skip

    def told(*shown_kg):
        takes = [taken(kg, shown) for kg, shown in zip((0.0, 1.0, 2.0), shown_kg, strict=True)]
        return {f.cause for f in check_trials(TrialSet(tuple(takes)))} & {"servo log", "payload"}

    assert told(0.0, 1.0, 2.0) == set()
    assert told(2.0, 1.0, 0.0) == {"servo log"}


def test_the_load_of_one_joint_is_compared_where_both_move_alike():
    """The second joint carries 1.4 times the load, and moves a little more in one trial."""
    trials = []
    for number, more in ((1, 1.001), (2, 0.999)):
        one = swung(1.0, number, dof=2)
        other = swung(1.0, number + 10, shown_kg=1.7).columns
        second = {f"{n}_2_{unit}": other[f"{n}_1_{unit}"] for n, unit in SIGNALS}
        second["angle_2_rad"] = more * one.columns["angle_1_rad"]
        trials.append(changed(one, **second))
    assert not [f for f in check_trials(TrialSet(tuple(trials))) if f.cause == "payload"]


def test_a_recording_that_was_imported_twice_is_told():
    once = swung(number=1)
    again = replace(once, name="again", meta=msgspec.structs.replace(once.meta, trial=2))
    found = check_trials(TrialSet((once, again)))
    assert [(f.level, f.cause) for f in found] == [("warning", "doubled")]


@pytest.mark.parametrize(("own", "told"), [("a" * 64, True), ("b" * 64, False), ("", False)])
def test_a_near_copy_is_told_by_its_recording(own, told):
    """Angles differ in the last digits, as after another import of the same file."""
    first, other = swung(number=1), swung(number=2)
    near = other.columns["angle_1_rad"] + 1e-9
    first = replace(first, meta=msgspec.structs.replace(first.meta, recording_sha256="a" * 64))
    other = changed(other, angle_1_rad=near)
    other = replace(other, meta=msgspec.structs.replace(other.meta, recording_sha256=own))
    found = judge_doubled((first, other))
    assert [f.cause for f in found] == ["doubled"] * told


def test_copies_of_one_name_are_told_apart_by_their_files():
    one = replace(swung(number=1), path=Path("a") / "x.csv")
    (found,) = judge_doubled((one, replace(one, path=Path("b") / "x.csv")))
    assert str(Path("a") / "x.csv") in found.text and str(Path("b") / "x.csv") in found.text


@pytest.mark.parametrize("pressure_pa, told", [(41300.0, False), (42000.0, False), (20700.0, True)])
def test_trials_of_several_pressures_are_told(pressure_pa, told):
    one, other = swung(number=1), swung(number=2)
    other = replace(other, meta=msgspec.structs.replace(other.meta, pressure_pa=pressure_pa))
    found = [f for f in check_trials(TrialSet((one, other))) if f.cause == "pressure"]
    assert bool(found) is told and all("20700 to 41300 Pa" in f.text for f in found)


def test_joints_that_move_together_matter_to_a_predictor_only():
    one = swung(dof=2)
    both = {f"{n}_2_{unit}": one.columns[f"{n}_1_{unit}"] for n, unit in SIGNALS}
    trials = [changed(one, **both), changed(swung(dof=2, number=2), **both)]
    (found,) = [f for f in check_trials(TrialSet(tuple(trials))) if f.cause == "joints"]
    assert found.level == "warning" and "to train a predictor" in found.remedy


def test_a_late_clock_of_trials_that_exist_is_mended_by_another_import_or_named():
    late = run_case(read_parameters().hide({"sync_offset": 0.02}), TrialCase(Motion(), 1.0, 1, 0))
    (found,) = [f for f in check_trial(late).findings if f.cause == "clock"]
    assert "late" in found.text and "again" in found.remedy and "dropstitch gap" in found.remedy
