"""The plant document: round trip, completion, provenance, refusals in one sentence."""

import json
import tomllib
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from firmware_py.bus.servo_models import ServoGains
from firmware_py.core.errors import InputError
from firmware_py.core.signals import unit_of
from models.plant.document import Evaluation, FittedTrial, Provenance, SignalError
from models.plant.parameter import impossible_sums
from models.plant.plant import NOMINAL, read_plant
from models.plant.step_model import names


@pytest.mark.parametrize("suffix", [".json", ".toml"])
def test_a_written_plant_reads_back_the_same(tmp_path, suffix):
    provenance = Provenance(
        parent_sha256="ab", fitted_trials=(FittedTrial("a", "12", "measured"),),
        residual_rms={"di": 1e-3},
        held_out=Evaluation(signals={"di": SignalError(1e-3, 2e-3, "1")}, trials=1, origins=()),
        named=("backlash",), servo_gains=(ServoGains(position_p=800, velocity_i=0),),
    )  # fmt: skip
    value, error = np.float64(2 / 3), np.float64(0.1)
    plant = read_plant().with_values({"link_mass_kg": value}, {"link_mass_kg": error})
    plant = replace(plant, provenance=provenance)
    path = tmp_path / f"plant{suffix}"
    plant.write(path)
    again = read_plant(path)
    assert again == plant
    assert again.sha256() == plant.sha256() != read_plant().sha256()


def test_a_written_plant_states_value_unit_bounds_and_source_of_everything(tmp_path):
    plant, path = read_plant(), tmp_path / "plant.toml"
    plant.write(path)
    written = tomllib.loads(path.read_text())["parameters"]
    assert written.keys() == plant.parameters.keys()
    for name, entry in written.items():
        q = plant.parameters[name]
        assert unit_of(name) in (entry["unit"], None), name
        assert entry["bounds"][0] <= entry["value"] <= entry["bounds"][1], name
        assert entry["source"] == q.source != "" and entry["role"] == q.role, name


def test_a_file_states_only_what_differs_from_the_parts(tmp_path):
    path = tmp_path / "plant.toml"
    lines = "base_mass_kg = 0.3\nlink_mass_kg = { value = 1.0, source = 'x' }\n"
    path.write_text(NOMINAL.read_text() + lines)
    usual, changed = read_plant().parameters, read_plant(path).parameters
    expected = {
        "base_mass_kg": msgspec.structs.replace(usual["base_mass_kg"], value=0.3),
        "link_mass_kg": msgspec.structs.replace(usual["link_mass_kg"], value=1.0, source="x"),
    }
    assert {name: q for name, q in changed.items() if q != usual[name]} == expected


def test_units_have_the_contracts_inputs_and_outputs():
    plant, dof, joints = read_plant(), 2, (1, 2)
    tip = ["tip_x_m", "tip_y_m", "tip_z_m"]
    angles, currents = [f"angle_{j}_rad" for j in joints], [f"current_{j}_a" for j in joints]
    twin, observer = plant.step_model(dof, "twin"), plant.step_model(dof, "observer")
    assert names(twin.inputs) == [*(f"goal_{j}_rad" for j in joints), "payload_kg"]
    assert names(twin.outputs) == [*angles, *currents, "di", *tip]
    assert names(observer.inputs) == [*angles, *currents]
    assert names(observer.outputs)[:5] == ["di", *tip, "payload_kg"]
    of_the_estimate = {f"tip_{axis}_deviation_m" for axis in "xyz"}
    for j in joints:
        of_the_estimate |= {f"bend_{j}_rad", f"bend_rate_{j}_rad_s"}
        of_the_estimate |= {f"joint_rate_{j}_rad_s", f"innovation_{j}_a"}
    assert set(names(observer.outputs)[5:]) == of_the_estimate
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
        (put("effects", [{"name": "magic"}]), "'magic' is no effect"),
        (put("schema", 7), "schema version 7"),
        (put("parameters", "mass_of_link_kg", 1.0), "'mass_of_link_kg' belongs to no part"),
        (put("parameters", "link_mass_kg", 90.0), "link_mass_kg is 90 kg, outside 0.5 to 2"),
        (put("parameters", "link_mass_kg", "unit", "g"), "is given in 'g'; convert it to 'kg'"),
        (put("colour", "blue"), "unknown field `colour`"),
        (put("effects", 2 * [{"name": "backlash"}]), "effect backlash stands twice; remove one"),
        (put("parameters", "link_mass_kg", "bounds", [3, 0.3]), "link_mass_kg are [3, 0.3], the l"),
        (put("parameters", "link_mass_kg", "bounds", [0, float("inf")]), "0 and inf, not finite"),
        (put("parameters", "link_mass_kg", "prior_deviation", -0.1), "link_mass_kg is -0.1; give"),
        (put("parameters", "link_mass_kg", "value", float("nan")), "link_mass_kg is not a finite"),
        (put("provenance", {"fitted_trials": [{"name": "a"}]}), "missing required field `sha256`"),
    ],
)
def test_a_wrong_document_is_refused_by_file_and_field(tmp_path, change, message):
    with pytest.raises(InputError) as refused:
        read_plant(edited(tmp_path, change))
    assert message in str(refused.value)
    assert str(tmp_path) in str(refused.value)


def test_a_file_of_another_form_is_refused(tmp_path):
    for suffix, text in (("json", "{"), ("toml", "schema = "), ("toml", "")):
        path = tmp_path / f"plant.{suffix}"
        path.write_text(text)
        with pytest.raises(InputError, match=r"not JSON|not TOML|no schema version"):
            read_plant(path)
    with pytest.raises(InputError, match="is missing"):
        read_plant(tmp_path / "missing.toml")


def test_a_value_outside_its_bounds_cannot_be_set():
    with pytest.raises(InputError, match="link_mass_kg is -1 kg"):
        read_plant().with_values({"link_mass_kg": -1.0})
    with pytest.raises(InputError, match="is no parameter"):
        read_plant().with_values({"mass": 1.0})


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


def test_sums_of_parameters_that_no_machine_has_are_impossible():
    full = read_plant().with_effects("unmodelled_payload", "current_saturation")
    values = {name: q.value for name, q in full.parameters.items()}
    assert impossible_sums(values, [0.0, 2.0]) == []
    light = values | {"tip_mass_kg": 0.144, "unmodelled_payload_kg": -0.2}
    (tip,) = impossible_sums(light, [0.0, 1.0])
    assert tip.value == pytest.approx(0.144 - 0.2)
    assert set(tip.parameters) == {"tip_mass_kg", "unmodelled_payload_kg"}
    assert impossible_sums(light, [1.0, 2.0]) == []
    for changes, what in (
        ({"coulomb_friction_2_nm": 1.0, "stribeck_friction_2_nm": -1.5}, "friction of joint 2"),
        ({"current_limit_1_a": 3.0, "current_saturation_1_a": 3.0}, "current limit of joint 1"),
    ):
        (total,) = impossible_sums(changes)
        assert total.what.replace("friction at standstill", "friction") == what
    assert impossible_sums({"coulomb_friction_1_nm": 0.0}) == []
