"""Doubts about an identification, each in one sentence; trials of another link are refused."""

from dataclasses import replace

import msgspec
import pytest

from dropstitch.__main__ import main
from firmware_py.errors import InputError
from models.plant.document import DofEvaluation, Evaluation, TipError
from models.plant.identification.doubts import (
    doubts,
    evaluation_doubts,
    refuse_other_links,
    torque_constant_doubts,
)
from models.plant.identification.identify import Identification
from models.plant.plant import read_plant
from models.predictor.fallback import doubts_of_di
from models.trials.checks.trials import check_trials
from models.trials.files import write_trial
from models.trials.trial import TrialSet


def found(*, fitted=(), tip_m=(0.002, 0.003), rigid_m=(0.02, 0.06)):
    payloads = {f"{k}": TipError(*pair) for k, pair in enumerate(zip(tip_m, rigid_m, strict=True))}
    dof = DofEvaluation(
        signals={}, trials=2, tip_rms_m=max(tip_m), rigid_tip_rms_m=max(rigid_m), payloads=payloads
    )
    return Identification(
        read_plant(), fitted, Evaluation(signals={}, trials=2, dof={"1": dof}, origins=())
    )


def test_a_good_plant_raises_no_doubt():
    assert doubts(found()) == []


def test_a_parameter_at_the_edge_of_its_range_is_named():
    mass = read_plant().parameters["link_mass_kg"]
    (said,) = doubts(found(fitted=(msgspec.structs.replace(mass, value=mass.high),)))
    assert "link_mass_kg is at its upper bound, 2 kg" in said


@pytest.mark.parametrize(
    "tip_m, rigid_m, named",
    [
        ((0.002, 0.027), (0.02, 0.196), "1DOF with 1 kg"),  # 14 % of a large deflection
        ((0.002, 0.009), (0.02, 0.196), None),  # 5 %
        ((0.003, 0.004), (0.02, 0.03), None),  # 13 % of a small one
        ((0.009, 0.004), (0.02, 0.06), None),  # without payload there is none to take off
    ],
)
def test_a_payload_that_is_badly_missed_is_named(tip_m, rigid_m, named):
    said = doubts(found(tip_m=tip_m, rigid_m=rigid_m))
    assert [s.split(":")[0] for s in said] == ([named] if named else [])
    assert all("less payload" in s for s in said)


def test_what_the_clock_explains_is_no_payload_missed():
    late = found(tip_m=(0.002, 0.012), rigid_m=(0.02, 0.06))
    dof = late.held_out.dof["1"]
    dof.payloads["1"] = TipError(0.012, 0.06, clock_tip_rms_m=0.004)
    assert doubts(late) == []


def test_a_plant_no_better_than_a_rigid_link_is_named_once():
    (said,) = doubts(found(tip_m=(0.02, 0.07), rigid_m=(0.02, 0.06)))
    assert "a rigid link" in said
    bad = found(tip_m=(0.02, 0.07), rigid_m=(0.02, 0.06))
    assert evaluation_doubts(bad.held_out, read_plant()) == [said]
    assert evaluation_doubts(found().held_out, read_plant()) == []


@pytest.mark.parametrize(("rigid_m", "told"), [(0.27, False), (1.43, True), (38.8, True)])
def test_a_tip_beyond_any_bend_is_told_though_plant_and_rigid_link_are_alike(rigid_m, told):
    """The study's link is 0.95 m long; its plant is a millimetre better, as with a wrong tip."""
    wrong = found(tip_m=(0.01, rigid_m - 1e-3), rigid_m=(0.01, rigid_m)).held_out
    said = evaluation_doubts(wrong, read_plant())
    assert [("no link bends so far" in text) for text in said] == [True] * told


def test_without_motion_capture_nothing_is_said_of_the_tip():
    assert doubts(found(tip_m=(0.0,), rigid_m=(0.1,))) == []
    dof = DofEvaluation(signals={}, trials=1, payloads={"0": TipError()})
    assert (
        doubts(
            Identification(
                read_plant(), (), Evaluation(signals={}, trials=1, dof={"1": dof}, origins=())
            )
        )
        == []
    )


@pytest.fixture
def payload_trials(synthetic):
    def make(constant_nm_a, payloads):
        plant = read_plant().with_values({"torque_constant_1_nm_a": constant_nm_a})
        return [synthetic(plant, load, count=300, trial=1) for load in payloads]

    return make


def test_a_wrong_constant_is_told(payload_trials):
    (said,) = torque_constant_doubts(read_plant(), payload_trials(4.8, (0.0, 1.5)))
    told = float(said.split("of about ")[1].split(" ")[0])
    assert told == pytest.approx(4.8, rel=0.05)
    assert "not 6.83" in said


def test_payloads_in_pounds_are_named_as_a_cause(payload_trials):
    pounds = [
        replace(t, meta=msgspec.structs.replace(t.meta, payload_kg=2.2046 * t.meta.payload_kg))
        for t in payload_trials(6.83, (0.0, 1.5))
    ]
    (said,) = torque_constant_doubts(read_plant(), pounds)
    assert "or the payloads are in pounds" in said


def test_a_current_that_falls_with_the_payload_is_no_constant(payload_trials):
    """Recordings in which the load's part of the current was turned."""
    light, heavy = payload_trials(6.83, (0.0, 1.5))
    of_payload = heavy.columns["current_1_a"] - light.columns["current_1_a"]
    turned = light.columns["current_1_a"] - of_payload
    heavy = replace(heavy, columns=heavy.columns | {"current_1_a": turned})
    (said,) = torque_constant_doubts(read_plant(), [light, heavy])
    assert "of joint 1" in said and "check the sign" in said
    assert "N.m/A" not in said


@pytest.mark.parametrize(
    ("constant_nm_a", "payloads"),
    [(6.83, (0.0, 1.5)), (6.6, (0.0, 1.5)), (4.8, (1.5,))],
    ids=["right", "within some per cent", "one payload tells nothing"],
)
def test_nothing_is_told_without_evidence(payload_trials, constant_nm_a, payloads):
    assert torque_constant_doubts(read_plant(), payload_trials(constant_nm_a, payloads)) == []


def test_a_constant_that_is_fitted_needs_no_doubt(payload_trials):
    given = read_plant()
    free = msgspec.structs.replace(given.parameters["torque_constant_1_nm_a"], role="nuisance")
    plant = replace(given, parameters=given.parameters | {free.name: free})
    assert torque_constant_doubts(plant, payload_trials(4.8, (0.0, 1.5))) == []


UPSIDE_DOWN = (0.0, 0.0, 9.81)


@pytest.fixture
def trials(toy_trials):
    """Two trials of the nominal link."""
    size = {"link_length_m": 0.95, "link_width_m": 0.15, "base_offset_m": 0.06}
    return [changed(t, **size) for t in toy_trials(1)[:2]]


def changed(trial, **conditions):
    return replace(trial, meta=msgspec.structs.replace(trial.meta, **conditions))


CHANGES = [
    {"link_length_m": 0.475}, {"link_width_m": 0.1}, {"base_offset_m": 0.3},
    {"gravity_m_s2": UPSIDE_DOWN},
]  # fmt: skip


@pytest.mark.parametrize("change", CHANGES)
def test_trials_of_two_links_are_refused_as_validate_refuses_them(trials, change):
    refuse_other_links(read_plant(), "plant.json", trials)
    mixed = [trials[0], changed(trials[1], **change)]
    with pytest.raises(InputError) as refusal:
        refuse_other_links(read_plant(), "plant.json", mixed)
    shared = check_trials(TrialSet(tuple(mixed)))
    found = next(f for f in shared if f.cause == "size")
    assert found.level == "refused"
    assert found.text in str(refusal.value)
    assert str(mixed[1].path) in str(refusal.value)


@pytest.mark.parametrize("change", CHANGES)
def test_trials_of_another_link_than_the_plants_are_refused(trials, change):
    others = [changed(t, **change) for t in trials]
    with pytest.raises(InputError, match=next(iter(change)).removesuffix("_m_s2")):
        refuse_other_links(read_plant(), "plant.json", others)


def test_a_length_by_the_tape_is_that_of_the_plant(trials):
    measured = [changed(t, link_length_m=0.946) for t in trials]
    refuse_other_links(read_plant(), "plant.json", measured)


@pytest.mark.parametrize(
    "command",
    [
        ["train", "--dof", "1", "--out", "bundle"],
        ["identify", "--out", "plant.json"],
        ["evaluate"],
        ["gap", "--out", "gap"],
        ["calibrate"],
    ],
)
def test_every_command_that_compares_trials_with_a_plant_refuses(
    trials, tmp_path, capsys, monkeypatch, command
):
    name, *options = command
    for trial in trials:
        write_trial(changed(trial, base_offset_m=0.3), tmp_path / "trials")
    monkeypatch.chdir(tmp_path)
    read_plant().write(tmp_path / "nominal.json")
    assert main([name, "trials", "--plant", "nominal.json", *options]) == 2
    told = capsys.readouterr().err.strip().splitlines()[-1]
    assert all(word in told for word in ("base_offset_m is 0.3 m", "nominal.json", "0.06 m"))
    assert not (tmp_path / "bundle").exists()


def test_an_estimate_of_the_di_that_is_worse_than_its_mean_is_told():
    assert doubts_of_di({"trial_2": 0.9, "unseen": 0.0}) == []
    assert doubts_of_di({}) == []
    (said,) = doubts_of_di({"trial_2": -0.1, "unseen": -1.035})
    assert said.startswith("R² of the estimated DI is -1.035 on unseen")
    assert "dropstitch validate" in said
