"""Plant and rig of a described link: values, bounds, payloads and markers follow the link."""

import json

import msgspec
import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.core.errors import InputError
from firmware_py.link.link_description import (
    STUDY_LINK,
    LinkDescription,
    LinkGravity,
    LinkServo,
)
from firmware_py.link.marker_layout import MarkerLayout, square_layout
from models.commands.new import link_toml
from models.plan.plan import check_grid
from models.plant.identification.doubts import refuse_other_links
from models.plant.parameter import check_payload
from models.plant.plant import read_plant
from models.plant.step_model import names
from models.rig.parameters import read_parameters, rig_of_link
from models.trials.trial import TrialSet
from tests.models.made_trials import with_conditions

STEP_S = 0.017
SMALL = LinkDescription(
    length_m=0.6, width_m=0.1, payload_kg=0.1, joints=1,
    markers=square_layout(0.6, 0.1, rows=3), servo=LinkServo(model="XM430-W350"),
    gravity=LinkGravity(mounting="hanging"),
)  # fmt: skip
HEAVY = LinkDescription(length_m=1.0, width_m=0.3, payload_kg=5.0, joints=1)


def test_the_studys_link_yields_the_studys_plant_and_rig(plant_of):
    plant, nominal = plant_of(STUDY_LINK), read_plant()
    for name, q in nominal.parameters.items():
        scaled = plant.parameters[name]
        assert (scaled.value, scaled.low, scaled.high) == pytest.approx((q.value, q.low, q.high))
    rig, study = rig_of_link(STUDY_LINK, "link.toml"), read_parameters()
    assert dict(rig) == pytest.approx(dict(study)) and rig.layout == study.layout


def test_every_value_stays_within_its_bounds_on_other_links(plant_of):
    for link in (SMALL, msgspec.structs.replace(SMALL, length_m=2.0, width_m=0.3, markers=None)):
        for q in plant_of(link).parameters.values():
            assert q.low <= q.value <= q.high, q.name
        for name, entry in rig_of_link(link, "link.toml").entries.items():
            assert entry.minimum <= entry.value <= entry.maximum, name


def test_a_written_plant_includes_its_link(plant_of, tmp_path):
    plant = plant_of(SMALL)
    for suffix in ("json", "toml"):
        plant.write(tmp_path / f"plant.{suffix}")
        read = read_plant(tmp_path / f"plant.{suffix}")
        assert read.link == plant.link and read.sha256() == plant.sha256()


def resting(plant, output):
    """Output of a twin that rests at 0.3 rad with 0.1 kg."""
    model = plant.step_model(1)
    y = model.simulate(np.tile([0.3, 0.1], (3, 1)), STEP_S)
    return y[0, names(model.outputs).index(output)]


def test_a_hanging_link_is_bent_inwards_and_an_upright_one_outwards(plant_of):
    """Statics: at rest at +0.3 rad the weight lies beyond the joint upright, below it hanging."""
    upright, hanging = (
        resting(
            plant_of(msgspec.structs.replace(SMALL, gravity=LinkGravity(mounting=m))), "tip_x_m"
        )
        for m in ("upright", "hanging")
    )
    assert hanging + 1e-3 < 0.66 * np.sin(0.3) < upright - 1e-3


def test_the_index_follows_the_places_of_the_markers(plant_of):
    """At a small bend the strain of an edge is in proportion to its distance from the axis."""
    corners = tuple((x / 2, y / 2) for x, y in SMALL.layout.corners_m)
    whole, half = (
        resting(plant_of(msgspec.structs.replace(SMALL, markers=layout))
                .with_values({"marker_noise_m": 0.0}), "di")
        for layout in (SMALL.layout, MarkerLayout(SMALL.layout.rows_m, corners))
    )  # fmt: skip
    assert half == pytest.approx(whole / 2, rel=1e-6) and whole > 1e-4


# --- payload: up to 3 kg in the study, half as much again as another link carries -----------------


@pytest.mark.parametrize("kind", ["twin", "observer", "driven"])
def test_the_largest_payload_of_a_plant_follows_from_its_link(plant_of, kind):
    for plant, most_kg in ((read_plant(), 3.0), (plant_of(HEAVY), 7.5), (plant_of(SMALL), 0.15)):
        model = plant.step_model(1, kind)
        rows = (*model.inputs, *model.parameters, *model.states, *model.outputs)
        bounds = {v.name: (v.minimum, v.maximum) for v in rows}
        assert bounds["payload_kg"] == (0.0, pytest.approx(most_kg))
        if kind != "twin":
            assert bounds["payload_known_kg"] == (-1.0, pytest.approx(most_kg))


def test_the_observer_of_a_heavy_link_estimates_its_payload(plant_of):
    plant = plant_of(HEAVY)
    twin, observer = plant.step_model(1, "twin"), plant.step_model(1, "observer")
    moving_s = STEP_S * np.maximum(np.arange(220) - 20, 0)
    goal_rad = -0.4 * np.sin(2 * np.pi / 3.0 * moving_s)
    measured = twin.simulate(np.column_stack([goal_rad, np.full(220, 5.0)]), STEP_S)[:, :2]
    estimate = observer.simulate(measured, STEP_S)[-1, names(observer.outputs).index("payload_kg")]
    assert estimate == pytest.approx(5.0, abs=0.2)


def test_payloads_beyond_the_link_are_refused(plant_of, make_trial):
    check_payload(7.5, link=HEAVY)
    with pytest.raises(InputError, match=r"--payload-kg: is 7.6 kg; give 0 to 7.5 kg"):
        check_payload(7.6, link=HEAVY)
    with pytest.raises(InputError, match=r"--payloads: is 2 kg; give 0 to 0.15 kg"):
        check_grid(plant_of(SMALL), (0.0, 2.0))
    plant = plant_of(msgspec.structs.replace(STUDY_LINK, payload_kg=1.0))
    trial = make_trial(np.zeros(8), payload_kg=2.0)
    with pytest.raises(InputError, match=r"payload of 2 kg, a plant of this link takes 1.5 kg"):
        refuse_other_links(plant, "plant.json", TrialSet((trial,)))
    refuse_other_links(plant, "plant.json", TrialSet((with_conditions(trial, payload_kg=1.5),)))


def test_a_payload_beyond_the_link_is_not_simulated(tmp_path, capsys):
    (tmp_path / "link.toml").write_text(link_toml(SMALL, 1.0, 1.0), encoding="utf-8")
    options = ["--rig", str(tmp_path / "link.toml"), "--payloads", "0.2"]
    assert main(["simulate", "--out", str(tmp_path / "trials"), *options]) == 2
    assert "choose 0 to 0.15, or raise payload_kg in" in capsys.readouterr().err


def test_the_default_payload_of_linearise_is_within_the_bounds(plant_of, tmp_path, capsys):
    plant_of(SMALL).write(tmp_path / "plant.json")
    command = ["linearise", "--plant", str(tmp_path / "plant.json"), "--json"]
    assert main([*command, "--out", str(tmp_path / "linear.json")]) == 0
    assert json.loads(capsys.readouterr().out)["payload_kg"] == 0.05
