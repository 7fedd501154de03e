"""Whether the payloads speak for another torque constant."""

from dataclasses import replace

import msgspec
import pytest

from models.plant.identification.doubts import torque_constant_doubts
from models.plant.plant import read_plant


@pytest.fixture
def trials(synthetic):
    def make(constant_nm_a, payloads):
        plant = read_plant().with_values({"torque_constant_1_nm_a": constant_nm_a})
        return [synthetic(plant, load, count=300, trial=1) for load in payloads]

    return make


def test_a_wrong_constant_is_told(trials):
    (said,) = torque_constant_doubts(read_plant(), trials(4.8, (0.0, 1.5)))
    told = float(said.split("of about ")[1].split(" ")[0])
    assert told == pytest.approx(4.8, rel=0.05)
    assert "not 6.83" in said


def test_payloads_in_pounds_are_named_as_a_cause(trials):
    pounds = [
        replace(t, meta=msgspec.structs.replace(t.meta, payload_kg=2.2046 * t.meta.payload_kg))
        for t in trials(6.83, (0.0, 1.5))
    ]
    (said,) = torque_constant_doubts(read_plant(), pounds)
    assert "or the payloads are in pounds" in said


def test_a_current_that_falls_with_the_payload_is_no_constant(trials):
    """Recordings in which the load's part of the current was turned."""
    light, heavy = trials(6.83, (0.0, 1.5))
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
def test_nothing_is_told_without_evidence(trials, constant_nm_a, payloads):
    assert torque_constant_doubts(read_plant(), trials(constant_nm_a, payloads)) == []


def test_a_constant_that_is_fitted_needs_no_doubt(trials):
    given = read_plant()
    free = msgspec.structs.replace(given.parameters["torque_constant_1_nm_a"], role="nuisance")
    plant = replace(given, parameters=given.parameters | {free.name: free})
    assert torque_constant_doubts(plant, trials(4.8, (0.0, 1.5))) == []
