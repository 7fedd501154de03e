"""Doubts about an identification, each in one sentence; trials of another link are refused."""

from dataclasses import replace

import msgspec
import pytest

from dropstitch.__main__ import main
from firmware_py.core.errors import InputError
from models.plant.document import DofEvaluation, Evaluation, TipError
from models.plant.identification.doubts import (
    doubts,
    evaluation_doubts,
    refuse_other_links,
    torque_constant_doubts,
)
from models.plant.plant import read_plant
from models.predictor.fallback import doubts_of_di
from models.trials.files import write_trial
from tests.models.made_trials import with_columns, with_conditions


def evaluation(tip_m=(0.002,), rigid_m=(0.02,), clock_m=(None,)):
    """Errors of the tip at 0 kg, 1 kg, …; the worst are those of all trials."""
    rows = [TipError(*row) for row in zip(tip_m, rigid_m, clock_m, strict=True)]
    dof = DofEvaluation(
        signals={}, trials=2, tip_rms_m=max(tip_m), rigid_tip_rms_m=max(rigid_m),
        payloads={f"{k}": row for k, row in enumerate(rows)},
    )  # fmt: skip
    return Evaluation(signals={}, trials=2, dof={"1": dof}, origins=())


def test_a_parameter_at_the_edge_of_its_range_is_named():
    mass = read_plant().parameters["link_mass_kg"]
    (doubt,) = doubts([msgspec.structs.replace(mass, value=mass.high)], evaluation())
    assert "link_mass_kg is at its upper bound, 2 kg" in doubt


@pytest.mark.parametrize(
    "tip_m, rigid_m, clock_m, of_fit, of_evaluation",
    [
        ((0.002, 0.027), (0.02, 0.196), None, "with 1 kg", None),  # 14 % of a large deflection
        ((0.003, 0.004), (0.02, 0.03), None, None, None),  # 13 % of a small one
        ((0.009, 0.004), (0.02, 0.06), None, None, None),  # no payload to take off
        ((0.002, 0.012), (0.02, 0.06), 0.004, None, None),  # the rest is the clock's
        ((0.02, 0.07), (0.02, 0.06), None, "a rigid link by", "a rigid link by"),
        ((0.01, 1.429), (0.01, 1.43), None, "with 1 kg", "no link bends so far"),
        ((None,), (None,), None, None, None),  # no motion capture
    ],
)
def test_an_error_of_the_tip_that_speaks_against_the_plant_is_named_once(
    tip_m, rigid_m, clock_m, of_fit, of_evaluation
):
    errors = evaluation(tip_m, rigid_m, (None, clock_m)[: len(tip_m)])
    of_result = doubts([], errors), evaluation_doubts(errors, read_plant())
    for warnings, phrase in zip(of_result, (of_fit, of_evaluation), strict=True):
        assert len(warnings) == (phrase is not None)
        assert all(phrase in text for text in warnings)


def payload_trials(synthetic, constant_nm_a=6.83, payloads=(0.0, 1.5)):
    plant = read_plant().with_values({"torque_constant_1_nm_a": constant_nm_a})
    return [synthetic(plant, load, count=300, trial=1) for load in payloads]


def test_payloads_reveal_a_wrong_torque_constant(synthetic):
    trials, plant = payload_trials(synthetic, 4.8), read_plant()
    (doubt,) = torque_constant_doubts(plant, trials)
    assert float(doubt.split("of about ")[1].split(" ")[0]) == pytest.approx(4.8, rel=0.05)
    free = msgspec.structs.replace(plant.parameters["torque_constant_1_nm_a"], role="nuisance")
    fitted = replace(plant, parameters=plant.parameters | {free.name: free})
    assert torque_constant_doubts(fitted, trials) == []


@pytest.mark.parametrize(("constant_nm_a", "payloads"), [(6.6, (0.0, 1.5)), (4.8, (1.5,))])
def test_a_constant_near_the_data_sheet_or_a_single_payload_raises_no_doubt(
    synthetic, constant_nm_a, payloads
):
    trials = payload_trials(synthetic, constant_nm_a, payloads)
    assert torque_constant_doubts(read_plant(), trials) == []


def test_wrong_payloads_and_currents_are_named_as_causes(synthetic):
    light, heavy = payload_trials(synthetic)
    pounds = with_conditions(heavy, payload_kg=2.2046 * heavy.meta.payload_kg)
    (doubt,) = torque_constant_doubts(read_plant(), [light, pounds])
    assert "or the payloads are in pounds" in doubt
    grams = with_conditions(heavy, payload_kg=1e3 * heavy.meta.payload_kg)
    assert not any("nan" in text for text in torque_constant_doubts(read_plant(), [light, grams]))
    turned = 2 * light.columns["current_1_a"] - heavy.columns["current_1_a"]
    falling = with_columns(heavy, current_1_a=turned)
    (doubt,) = torque_constant_doubts(read_plant(), [light, falling])
    assert "of joint 1" in doubt and "check the sign" in doubt


@pytest.fixture
def trials(toy_trials):
    """Two trials of the nominal link."""
    size = {"link_length_m": 0.95, "link_width_m": 0.15, "base_offset_m": 0.06}
    return [with_conditions(t, **size) for t in toy_trials(1)[:2]]


@pytest.mark.parametrize(
    "change",
    [{"link_length_m": 0.475}, {"base_offset_m": 0.3}, {"gravity_m_s2": (0.0, 0.0, 9.81)}],
)
def test_trials_of_another_link_are_refused(trials, change):
    measured = [with_conditions(t, link_length_m=0.946) for t in trials]  # a length by the tape
    refuse_other_links(read_plant(), "plant.json", measured)
    by_tape = [trials[0], with_conditions(trials[1], link_length_m=0.9501)]
    by_tape.append(with_conditions(trials[1], gravity_m_s2=(0.0, 0.0, -9.80665)))
    refuse_other_links(read_plant(), "plant.json", by_tape)
    mixed = [trials[0], with_conditions(trials[1], **change)]
    with pytest.raises(InputError, match=str(mixed[1].path)):
        refuse_other_links(read_plant(), "plant.json", mixed)
    with pytest.raises(InputError, match=next(iter(change)).removesuffix("_m_s2")):
        refuse_other_links(
            read_plant(), "plant.json", [with_conditions(t, **change) for t in trials]
        )


@pytest.mark.parametrize(
    "command",
    [
        ["train", "--dof", "1", "--out", "bundle"],
        ["identify", "--out", "plant.json"],
        ["evaluate"],
        ["gap", "--out", "gap"],
    ],
)
def test_every_command_that_compares_trials_with_a_plant_refuses(
    trials, tmp_path, capsys, monkeypatch, command
):
    name, *options = command
    for trial in trials:
        write_trial(with_conditions(trial, base_offset_m=0.3), tmp_path / "trials")
    monkeypatch.chdir(tmp_path)
    read_plant().write(tmp_path / "nominal.json")
    assert main([name, "trials", "--plant", "nominal.json", *options]) == 2
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert all(word in error for word in ("base_offset_m is 0.3,", "nominal.json", "0.06"))
    assert not (tmp_path / "bundle").exists()


def test_an_estimate_of_the_di_that_is_worse_than_its_mean_is_named():
    assert doubts_of_di({"trial_2": 0.9, "unseen": 0.0}) == []
    (doubt,) = doubts_of_di({"trial_2": -0.1, "unseen": -1.035})
    assert "-1.035 on unseen" in doubt
