"""The plant document: round trip, completion, refusals in one sentence."""

import json
import tomllib
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from firmware_py.errors import InputError
from firmware_py.signals import unit_of
from models.plant.plant import NOMINAL, read_plant
from models.plant.step_model import names


@pytest.mark.parametrize("suffix", [".json", ".toml"])
def test_a_document_comes_back_the_same(tmp_path, suffix):
    plant = read_plant().with_values({"link_mass_kg": 2 / 3}, {"link_mass_kg": 0.1})
    path = tmp_path / f"plant{suffix}"
    plant.write(path)
    again = read_plant(path)
    assert again.parameters.keys() == plant.parameters.keys()
    for name, q in plant.parameters.items():
        other = again.parameters[name]
        assert (q.value, q.low, q.high, q.unit, q.role, q.source, q.error) == (
            other.value, other.low, other.high, other.unit, other.role, other.source, other.error
        )  # fmt: skip
    assert again.sha256() == plant.sha256()
    assert (again.drive, again.load, again.effects) == (plant.drive, plant.load, plant.effects)


def test_a_parameter_that_an_older_file_lacks_has_its_default(tmp_path):
    path = tmp_path / "plant.json"
    read_plant().with_effects("dead_time").write(path)
    document = json.loads(path.read_text())
    for joint in (1, 2):
        del document["parameters"][f"dead_time_phase_{joint}"]
    path.write_text(json.dumps(document))
    assert read_plant(path).parameters["dead_time_phase_1"].value == 0.0


def test_a_written_plant_gives_value_unit_bounds_and_source_of_everything(tmp_path):
    """Without a look at the parts that declare them."""
    plant, path = read_plant(), tmp_path / "plant.toml"
    plant.write(path)
    written = tomllib.loads(path.read_text())["parameters"]
    assert written.keys() == plant.parameters.keys()
    for name, entry in written.items():
        q = plant.parameters[name]
        assert unit_of(name) in (entry["unit"], None), name
        assert entry["bounds"][0] <= entry["value"] <= entry["bounds"][1], name
        assert entry["source"] == q.source != "" and entry["role"] == q.role, name


def test_a_file_gives_what_differs_from_the_parts(tmp_path):
    path = tmp_path / "plant.toml"
    lines = "base_mass_kg = 0.3\nlink_mass_kg = { value = 1.0, source = 'x' }\n"
    path.write_text(NOMINAL.read_text() + lines)
    usual, own = read_plant().parameters, read_plant(path).parameters
    changed = {name for name, q in own.items() if q != usual[name]}
    assert changed == {"base_mass_kg", "link_mass_kg"}
    assert own["base_mass_kg"] == msgspec.structs.replace(usual["base_mass_kg"], value=0.3)
    heavy = msgspec.structs.replace(usual["link_mass_kg"], value=1.0, source="x")
    assert own["link_mass_kg"] == heavy


OF_THE_ESTIMATE = [
    ("bend", "rad"), ("bend_rate", "rad_s"), ("joint_rate", "rad_s"), ("innovation", "a"),
]  # fmt: skip


@pytest.mark.parametrize("dof", [1, 2])
def test_units_have_the_contracts_inputs_and_outputs(dof):
    plant, joints = read_plant(), range(1, dof + 1)
    tip = ["tip_x_m", "tip_y_m", "tip_z_m"]
    angles, currents = [f"angle_{j}_rad" for j in joints], [f"current_{j}_a" for j in joints]
    twin, observer = plant.step_model(dof, "twin"), plant.step_model(dof, "observer")
    assert names(twin.inputs) == [*(f"goal_{j}_rad" for j in joints), "payload_kg"]
    assert names(twin.outputs) == [*angles, *currents, "di", *tip]
    assert names(observer.inputs) == [*angles, *currents]
    assert names(observer.outputs)[:5] == ["di", *tip, "payload_kg"]
    assert set(names(observer.outputs)[5:]) == {
        *(f"{name}_{j}_{unit}" for j in joints for name, unit in OF_THE_ESTIMATE),
        *(f"tip_{axis}_deviation_m" for axis in "xyz"),
    }
    springs, creep_branches, shape_of_goal, sampling, step_length = 2, 3, 3, 1, 1
    own = 8 + shape_of_goal + sampling + springs * creep_branches
    assert len(twin.states) == own * dof + step_length
    every = (*twin.inputs, *twin.outputs, *observer.inputs, *observer.outputs)
    assert all((unit_of(v.name) or "1") == v.unit for v in every)


def edited(tmp_path, change):
    document = json.loads(msgspec.json.encode(read_plant().document()))
    change(document)
    path = tmp_path / "plant.json"
    path.write_text(json.dumps(document))
    return path


def put(*keys_and_value):
    *keys, last, value = keys_and_value

    def change(document):
        for key in keys:
            document = document[key]
        document[last] = value

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (put("drive", "kind", "hydraulic"), "'hydraulic' is no drive; choose from cascade"),
        (put("load", "kind", "rope"), "'rope' is no load; choose from link"),
        (put("effects", [{"name": "magic"}]), "'magic' is no effect"),
        (put("schema", 7), "schema version 7"),
        (put("parameters", "mass_of_link_kg", 1.0), "'mass_of_link_kg' belongs to no part"),
        (put("parameters", "link_mass_kg", 90.0), "link_mass_kg is 90 kg, outside 0.5 to 2"),
        (put("parameters", "link_mass_kg", "unit", "g"), "is given in 'g'; convert it to 'kg'"),
        (put("parameters", "link_mass_kg", "value", "heavy"), "Expected `float`"),
        (put("colour", "blue"), "unknown field `colour`"),
        (put("effects", 2 * [{"name": "backlash"}]), "effect backlash stands twice; remove one"),
        (put("parameters", "link_mass_kg", "bounds", [3, 0.3]), "link_mass_kg are [3, 0.3], the l"),
        (put("parameters", "link_mass_kg", "bounds", [0, float("inf")]), "0 and inf, not finite"),
        (put("parameters", "link_mass_kg", "prior_deviation", -0.1), "link_mass_kg is -0.1; give"),
        (
            put("parameters", "link_mass_kg", "error", float("nan")),
            "error of parameter link_mass_kg",
        ),
        (put("parameters", "link_mass_kg", "value", float("nan")), "link_mass_kg is not a finite"),
    ],
)
def test_what_is_wrong_with_a_document_is_said(tmp_path, change, message):
    with pytest.raises(InputError) as refused:
        read_plant(edited(tmp_path, change))
    assert message in str(refused.value)
    assert str(tmp_path) in str(refused.value)


@pytest.mark.parametrize("text", ["{", "schema = ", ""])
def test_what_is_no_document_is_refused(tmp_path, text):
    for suffix in ("json", "toml"):
        path = tmp_path / f"plant.{suffix}"
        path.write_text(text)
        with pytest.raises(
            InputError, match=r"no plant document|not JSON|not TOML|no schema version"
        ):
            read_plant(path)
    with pytest.raises(InputError, match="is missing"):
        read_plant(tmp_path / "missing.toml")


def test_a_value_outside_its_bounds_cannot_be_set():
    with pytest.raises(InputError, match="link_mass_kg is -1 kg"):
        read_plant().with_values({"link_mass_kg": -1.0})
    with pytest.raises(InputError, match="is no parameter"):
        read_plant().with_values({"mass": 1.0})


def test_values_of_numpy_are_written_as_numbers(tmp_path):
    value = np.float64(2 / 3)
    plant = read_plant().with_values({"link_mass_kg": value}, {"link_mass_kg": np.float64(0.1)})
    plant.write(tmp_path / "plant.json")
    again = read_plant(tmp_path / "plant.json").parameters["link_mass_kg"]
    assert (again.value, again.error) == (2 / 3, 0.1)


def test_plants_that_differ_in_values_alone_share_their_functions():
    """Values are arguments; whether one is fixed at zero, and its bounds, are of the functions."""
    plant = read_plant()
    mass = plant.parameters["link_mass_kg"]
    heavier = plant.with_values({mass.name: 1.1 * mass.value})
    one, other = plant.step_model(1), heavier.step_model(1)
    assert one.rate is other.rate
    k = names(one.parameters).index(mass.name)
    assert other.parameter_values()[k] == 1.1 * one.parameter_values()[k] == 1.1 * mass.value
    known = plant.parameters["payload_known_kg"]
    bounded = replace(
        plant,
        parameters=plant.parameters | {known.name: msgspec.structs.replace(known, high=1.5)},
    )
    texts = [p.step_model(1, "observer").finish.serialize() for p in (plant, bounded)]
    assert texts[0] != texts[1]
