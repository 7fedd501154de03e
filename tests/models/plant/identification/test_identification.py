"""Identification of plants whose parameters are known, from noisy runs of them."""

import json

import numpy as np
import pytest

from dropstitch.__main__ import main
from models.plant.identification.fit import Objective, fit_objective
from models.plant.identification.identify import (
    SHAPE,
    identify,
    starts_with_alike_servos,
)
from models.plant.plant import NOMINAL, read_plant
from models.trials.files import write_trial

SHIFTED = (
    "link_mass_kg", "root_stiffness_1_nm_rad", "span_stiffness_1_nm_rad",
    "root_damping_1_nm_s_rad", "coulomb_friction_1_nm", "load_dependent_friction_1",
    "hysteresis_share_1", "creep_share_1", "position_gain_1_per_s",
)  # fmt: skip
STIFF = {"root_limit_moment_nm": 40.0, "directional_stiffness_1": 0.15}


def drawn(seed):
    """A plant near the nominal one, its second plane like the first."""
    rng = np.random.default_rng(seed)
    nominal = read_plant()
    values = {n: nominal.parameters[n].value * rng.uniform(0.8, 1.25) for n in SHIFTED}
    values |= STIFF | {"prebend_1_rad": rng.uniform(-0.02, 0.02)}
    for name, value in dict(values).items():
        other = name.replace("_1", "_2", 1)
        if other in nominal.parameters:
            values[other] = value
    return nominal.with_values(values), rng


def trials_of(plant, synthetic, rng, payloads, numbers=(1, 2)):
    return [
        synthetic(plant, load, count=420, trial=k, rng=rng) for load in payloads for k in numbers
    ]


OPTIONS = {
    "profile": {"profile_acceleration_1_rad_s2": 18.0},
    "feedforward": {"velocity_feedforward_1": 0.4, "position_integral_1_per_s2": 5.0},
}
"""What servos may have beside the cascade."""


@pytest.mark.slow
@pytest.mark.parametrize("seed, option", [(2, "profile"), (5, "feedforward")])
def test_known_parameters_are_recovered(synthetic, monkeypatch, seed, option):
    # Synthetic markers have the right distances, but not the right places beside the tip.
    monkeypatch.setattr("models.plant.identification.identify.refuse_unusable", lambda trials: None)
    true, rng = drawn(seed)
    of_servo = OPTIONS[option]
    true = true.with_values(of_servo | {n.replace("_1", "_2", 1): v for n, v in of_servo.items()})
    start = read_plant()
    result = identify(start, trials_of(true, synthetic, rng, (0.0, 1.0, 2.0)))
    assert result.held_out.tip_rms_m < min(1e-3, 0.05 * result.held_out.rigid_tip_rms_m)
    assert result.held_out.signals["angle_1_rad"].rms < 1e-3
    assert result.held_out.signals["di"].rms < 3e-4
    q, p = result.plant.parameters, true.parameters
    for name, share in {
        "link_mass_kg": 0.15, "coulomb_friction_1_nm": 0.1, "load_dependent_friction_1": 0.15,
        "position_gain_1_per_s": 0.01,
    }.items():  # fmt: skip
        assert q[name].value == pytest.approx(p[name].value, rel=share), name

    def tip_compliance(parameters):
        lever = {"root": 1.0, "span": 1 - parameters["span_position"].value}
        return sum(
            lever[h] ** 2 / parameters[f"{h}_stiffness_1_nm_rad"].value for h in ("root", "span")
        )

    # hysteresis and creep carry part of the stiffness, so that springs alone are known less well
    assert tip_compliance(q) == pytest.approx(tip_compliance(p), rel=0.15)
    for name in (n for values in OPTIONS.values() for n in values):
        assert q[name].role == ("nuisance" if name in of_servo else "fixed"), name
        assert q[name].value == pytest.approx(p[name].value, rel=0.05, abs=0.02), name
    for parameter in result.fitted:
        assert parameter.low <= parameter.value <= parameter.high
        assert parameter.error is not None and parameter.error > 0
    # No trial moves the second plane.
    for name in ("root_stiffness_1_nm_rad", "coulomb_friction_1_nm", "creep_share_1"):
        assert q[name.replace("_1", "_2", 1)].value == q[name].value
    assert q["prebend_2_rad"].value == start.parameters["prebend_2_rad"].value


def test_occluded_markers_do_not_shift_the_estimate(synthetic):
    true, rng = drawn(4)
    (trial,) = trials_of(true, synthetic, rng, (1.0,), (1,))
    free = ["root_stiffness_1_nm_rad", "edge_gain"]
    results = []
    for share in (0.0, 0.3):
        hidden = rng.random((len(trial), 16)) < share
        hidden[:5] = False
        for i in range(16):
            for axis in "xyz":
                column = trial.columns[f"m{i + 1:02d}_{axis}_m"]
                column[hidden[:, i]] = np.nan
        start = true.with_values({"root_stiffness_1_nm_rad": 300.0, "edge_gain": 0.9})
        objective = Objective(start, "driven", [trial], free, ("tip", "di"))
        results.append(fit_objective(objective).plant.parameters)
    whole, part = results
    assert part["edge_gain"].value == pytest.approx(whole["edge_gain"].value, rel=0.02)
    assert part["root_stiffness_1_nm_rad"].value == pytest.approx(
        true.parameters["root_stiffness_1_nm_rad"].value, rel=0.02
    )


def test_a_fit_that_starts_at_the_truth_stays_there(synthetic):
    true, _ = drawn(5)
    trials = [synthetic(true, load, count=300) for load in (0.5, 2.0)]
    solution = fit_objective(Objective(true, "twin", trials, SHIFTED, ("tip", "angle", "current")))
    assert solution.cost < 1e-6
    q, p = solution.plant.parameters, true.parameters
    assert [q[n].value for n in SHIFTED] == pytest.approx([p[n].value for n in SHIFTED], rel=1e-6)


@pytest.mark.slow
def test_two_joints_have_their_values_each(synthetic):
    true, rng = drawn(6)
    second = {"root_stiffness_2_nm_rad": 300.0, "coulomb_friction_2_nm": 3.5}
    first = {"root_stiffness_1_nm_rad": 400.0, "coulomb_friction_1_nm": 5.0}
    trials = [synthetic(true.with_values(second | first), 1.0, count=300, rng=rng, dof=2)]
    free = (*second, *first)
    objective = Objective(true, "driven", trials, free, ("tip", "di", "current"))
    q = fit_objective(objective).plant.parameters
    for name, value in (second | first).items():
        assert q[name].value == pytest.approx(value, rel=0.05), name


@pytest.mark.slow
def test_the_commands_write_what_they_print(synthetic, tmp_path, capsys, monkeypatch):
    # Of the synthetic markers only the lengths between them are right, not where they stand.
    monkeypatch.setattr("models.trials.checks.trials.judge_tip", lambda trial: [])
    true, rng = drawn(7)
    for trial in trials_of(true, synthetic, rng, (0.0, 2.0)):
        write_trial(trial, tmp_path / "trials")
    out = tmp_path / "plant.json"
    arguments = ["identify", str(tmp_path / "trials"), "--plant", str(NOMINAL), "--out", str(out)]
    assert main([*arguments, "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    written = json.loads(out.read_text())
    assert (tmp_path / "plant.svg").read_text().startswith("<?xml")
    for name, row in printed["parameters"].items():
        assert written["parameters"][name]["value"] == row["value"]
    options = [n for values in OPTIONS.values() for n in values]
    assert all(written["parameters"][name]["role"] == "fixed" for name in options)
    provenance = written["provenance"]
    assert provenance["parent_sha256"] == read_plant().sha256()
    assert {t["name"] for t in provenance["fitted_trials"]} == {
        f"dof1_payload{load}_trial1" for load in (0, 2)
    }
    assert provenance["held_out"]["tip_rms_m"] == printed["held_out"]["tip_rms_m"]

    assert main(["evaluate", str(tmp_path / "trials"), "--plant", str(out), "--json"]) == 0
    evaluated = json.loads(capsys.readouterr().out)
    assert set(evaluated["signals"]["tip_x_m"]) == {"rms", "mae", "unit"}
    assert evaluated["tip_rms_m"] < evaluated["rigid_tip_rms_m"]
    assert set(evaluated["dof"]["1"]["payloads"]) == {"0", "2"}
    assert main(["evaluate", str(tmp_path / "trials"), "--plant", "nowhere.toml"]) == 2
    assert "nowhere.toml: is missing" in capsys.readouterr().err


# Further starts of the drive's fit, whose cost has several local minima


@pytest.mark.parametrize("second, others", [((1.0, 1.0, 0.0), 2), ((0.25, 0.3, 0.003), 0)])
def test_the_shape_of_either_joints_goals_is_tried_for_both_if_they_differ(second, others):
    first = (0.0, 0.3, 0.003)
    plant = read_plant().with_values({
        name.format(j=j): value
        for j, shape in ((1, first), (2, second)) for name, value in zip(SHAPE, shape, strict=True)
    })  # fmt: skip
    shapes = [
        [tuple(start.parameters[n.format(j=j)].value for n in SHAPE) for j in (1, 2)]
        for start in starts_with_alike_servos(plant)
    ]
    assert shapes == [2 * [first], 2 * [second]][:others]
