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
from models.trials.files import write_trial


def identified(fitted=(), tip_m=(0.002, 0.003), rigid_m=(0.02, 0.06), clock_m=(None, None)):
    """Result with these errors of the tip at 0 kg, 1 kg, …"""
    errors = enumerate(zip(tip_m, rigid_m, clock_m, strict=True))
    dof = DofEvaluation(
        signals={}, trials=2, tip_rms_m=max(tip_m), rigid_tip_rms_m=max(rigid_m),
        payloads={f"{k}": TipError(*row) for k, row in errors},
    )  # fmt: skip
    errors = Evaluation(signals={}, trials=2, dof={"1": dof}, origins=())
    return Identification(read_plant(), fitted, errors)


def test_a_parameter_at_the_edge_of_its_range_is_named():
    mass = read_plant().parameters["link_mass_kg"]
    (doubt,) = doubts(identified(fitted=(msgspec.structs.replace(mass, value=mass.high),)))
    assert "link_mass_kg is at its upper bound, 2 kg" in doubt


@pytest.mark.parametrize(
    "tip_m, rigid_m, clock_m, named",
    [
        ((0.002, 0.027), (0.02, 0.196), None, True),  # 14 % of a large deflection
        ((0.002, 0.009), (0.02, 0.196), None, False),  # 5 %
        ((0.003, 0.004), (0.02, 0.03), None, False),  # 13 % of a small one
        ((0.009, 0.004), (0.02, 0.06), None, False),  # without payload there is none to take off
        ((0.002, 0.012), (0.02, 0.06), 0.004, False),  # the rest is the clock's
    ],
)
def test_a_payload_that_is_badly_missed_is_named(tip_m, rigid_m, clock_m, named):
    warnings = doubts(identified((), tip_m, rigid_m, (None, clock_m)))
    assert [w.split(":")[0] for w in warnings] == ["1DOF with 1 kg"] * named


def test_a_plant_no_better_than_a_rigid_link_is_named_once():
    bad = identified(tip_m=(0.02, 0.07), rigid_m=(0.02, 0.06))
    (doubt,) = doubts(bad)
    assert "a rigid link" in doubt
    assert evaluation_doubts(bad.held_out, read_plant()) == [doubt]
    assert evaluation_doubts(identified().held_out, read_plant()) == []


@pytest.mark.parametrize(("rigid_m", "is_beyond"), [(0.27, False), (1.43, True)])
def test_a_tip_beyond_any_bend_is_named_though_plant_and_rigid_link_are_alike(rigid_m, is_beyond):
    """The study's link is 0.95 m long; its plant is a millimetre better, as with a wrong tip."""
    wrong = identified(tip_m=(0.01, rigid_m - 1e-3), rigid_m=(0.01, rigid_m)).held_out
    warnings = evaluation_doubts(wrong, read_plant())
    assert ["no link bends so far" in text for text in warnings] == [True] * is_beyond


def test_without_motion_capture_there_is_no_doubt_about_the_tip():
    dof = DofEvaluation(signals={}, trials=1, payloads={"0": TipError()})
    errors = Evaluation(signals={}, trials=1, dof={"1": dof}, origins=())
    assert doubts(Identification(read_plant(), (), errors)) == []


@pytest.fixture
def payload_trials(synthetic):
    def make(constant_nm_a, payloads):
        plant = read_plant().with_values({"torque_constant_1_nm_a": constant_nm_a})
        return [synthetic(plant, load, count=300, trial=1) for load in payloads]

    return make


def test_payloads_reveal_a_wrong_torque_constant(payload_trials):
    trials = payload_trials(4.8, (0.0, 1.5))
    (doubt,) = torque_constant_doubts(read_plant(), trials)
    assert float(doubt.split("of about ")[1].split(" ")[0]) == pytest.approx(4.8, rel=0.05)
    free = msgspec.structs.replace(
        read_plant().parameters["torque_constant_1_nm_a"], role="nuisance"
    )
    fitted = replace(read_plant(), parameters=read_plant().parameters | {free.name: free})
    assert torque_constant_doubts(fitted, trials) == []


@pytest.mark.parametrize(("constant_nm_a", "payloads"), [(6.6, (0.0, 1.5)), (4.8, (1.5,))])
def test_a_constant_near_the_data_sheet_or_a_single_payload_raises_no_doubt(
    payload_trials, constant_nm_a, payloads
):
    assert torque_constant_doubts(read_plant(), payload_trials(constant_nm_a, payloads)) == []


def test_payloads_in_pounds_are_named_as_a_cause(payload_trials):
    pounds = [
        changed(t, payload_kg=2.2046 * t.meta.payload_kg) for t in payload_trials(6.83, (0.0, 1.5))
    ]
    (doubt,) = torque_constant_doubts(read_plant(), pounds)
    assert "or the payloads are in pounds" in doubt


def test_a_current_that_falls_with_the_payload_is_no_constant(payload_trials):
    light, heavy = payload_trials(6.83, (0.0, 1.5))
    of_payload = heavy.columns["current_1_a"] - light.columns["current_1_a"]
    turned = light.columns["current_1_a"] - of_payload
    heavy = replace(heavy, columns=heavy.columns | {"current_1_a": turned})
    (doubt,) = torque_constant_doubts(read_plant(), [light, heavy])
    assert "of joint 1" in doubt and "check the sign" in doubt


@pytest.fixture
def trials(toy_trials):
    """Two trials of the nominal link."""
    size = {"link_length_m": 0.95, "link_width_m": 0.15, "base_offset_m": 0.06}
    return [changed(t, **size) for t in toy_trials(1)[:2]]


def changed(trial, **conditions):
    return replace(trial, meta=msgspec.structs.replace(trial.meta, **conditions))


@pytest.mark.parametrize(
    "change",
    [{"link_length_m": 0.475}, {"base_offset_m": 0.3}, {"gravity_m_s2": (0.0, 0.0, 9.81)}],
)
def test_trials_of_another_link_are_refused(trials, change):
    measured = [changed(t, link_length_m=0.946) for t in trials]  # a length by the tape
    refuse_other_links(read_plant(), "plant.json", measured)
    mixed = [trials[0], changed(trials[1], **change)]
    with pytest.raises(InputError, match=str(mixed[1].path)):
        refuse_other_links(read_plant(), "plant.json", mixed)
    with pytest.raises(InputError, match=next(iter(change)).removesuffix("_m_s2")):
        refuse_other_links(read_plant(), "plant.json", [changed(t, **change) for t in trials])


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
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert all(word in error for word in ("base_offset_m is 0.3 m", "nominal.json", "0.06 m"))
    assert not (tmp_path / "bundle").exists()


def test_an_estimate_of_the_di_that_is_worse_than_its_mean_is_named():
    assert doubts_of_di({"trial_2": 0.9, "unseen": 0.0}) == []
    (doubt,) = doubts_of_di({"trial_2": -0.1, "unseen": -1.035})
    assert "-1.035 on unseen" in doubt
