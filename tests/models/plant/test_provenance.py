"""Provenance: the fitted trials are kept from plant to plant, and another form is refused."""

import json
from dataclasses import replace

import msgspec
import pytest

from firmware_py.bus.servo_settings import ServoGains
from firmware_py.errors import InputError
from models.plant.document import Evaluation, FittedTrial, Provenance, SignalError
from models.plant.plant import NOMINAL, read_plant

EXAMPLES = sorted((NOMINAL.parent / "examples").glob("*_identified.json"))


def with_table(tmp_path, table):
    document = msgspec.to_builtins(read_plant().document()) | {"provenance": table}
    path = tmp_path / "plant.json"
    path.write_text(json.dumps(document))
    return path


def test_two_trials_of_one_name_are_both_kept(make_trial, swing_rad):
    first, second = make_trial(swing_rad), make_trial(0.5 * swing_rad)
    assert first.name == second.name
    parent = Provenance(fitted_trials=Provenance().fitted_with([first]))
    child = Provenance(fitted_trials=parent.fitted_with([second, first]))
    assert [t.sha256 for t in child.fitted_trials] == [first.sha256(), second.sha256()]
    assert child.was_fitted_to(first) and child.was_fitted_to(second)
    assert not parent.was_fitted_to(second)
    assert parent.was_fitted_to(replace(first, name="renamed"))


@pytest.mark.parametrize("suffix", [".json", ".toml"])
def test_a_provenance_comes_back_the_same(tmp_path, suffix):
    provenance = Provenance(
        parent_sha256="ab", fitted_trials=(FittedTrial("a", "12", "measured"),),
        residual_rms={"di": 1e-3},
        held_out=Evaluation(signals={"di": SignalError(1e-3, 2e-3, "1")}, trials=1, origins=()),
        named=("backlash",), servo_gains=(ServoGains(position_p=800, velocity_i=0),),
    )  # fmt: skip
    path = tmp_path / f"plant{suffix}"
    replace(read_plant(), provenance=provenance).write(path)
    assert read_plant(path).provenance == provenance


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"fitted_trials": ["a", "b"]}, "Expected `object`, got `str`"),
        ({"fitted_trials": [{"name": "a"}]}, "missing required field `sha256`"),
        ({"fitted_trials": {"a": "12"}}, "Expected `array`, got `object`"),
        ({"parents": "ab"}, "unknown field `parents`"),
        ("ab", "Expected `object`"),
    ],
)
def test_a_provenance_of_another_form_is_refused(tmp_path, table, message):
    path = with_table(tmp_path, table)
    with pytest.raises(InputError) as refused:
        read_plant(path)
    assert message in str(refused.value)
    assert str(path) in str(refused.value)
    assert "dropstitch identify" in str(refused.value)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_the_shipped_plants_tell_their_trials_in_this_form(path):
    table = json.loads(path.read_text())["provenance"]
    provenance = msgspec.convert(table, Provenance)
    assert provenance.fitted_trials
    assert all(len(t.sha256) == 64 for t in provenance.fitted_trials)
