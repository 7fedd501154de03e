"""Doubts about an identification: each in one sentence, and none about a good one."""

import msgspec
import pytest

from models.plant.document import DofEvaluation, Evaluation, TipError
from models.plant.identification.doubts import doubts, evaluation_doubts
from models.plant.identification.identify import Identification
from models.plant.plant import read_plant


def found(*, fitted=(), tip_m=(0.002, 0.003), rigid_m=(0.02, 0.06)):
    payloads = {f"{k}": TipError(*pair) for k, pair in enumerate(zip(tip_m, rigid_m, strict=True))}
    dof = DofEvaluation(
        signals={}, trials=2, tip_rms_m=max(tip_m), rigid_tip_rms_m=max(rigid_m), payloads=payloads
    )
    return Identification(
        read_plant(), fitted, Evaluation(signals={}, trials=2, dof={"1": dof}, origins=())
    )


def test_a_good_plant_raises_none():
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
