"""A plant and a rig of a described link: the study's link gives the study's, others follow."""

import msgspec
import numpy as np
import pytest

from firmware_py.link.link_description import (
    STUDY_LINK,
    LinkDescription,
    LinkGravity,
    LinkServo,
)
from firmware_py.link.marker_layout import MarkerLayout, square_layout
from models.plant.plant import read_plant
from models.rig.parameters import read_parameters, rig_of_link

SMALL = LinkDescription(
    length_m=0.6, width_m=0.1, payload_kg=0.1, joints=1,
    markers=square_layout(0.6, 0.1, rows=3), servo=LinkServo(model="XM430-W350"),
    gravity=LinkGravity(mounting="hanging"),
)  # fmt: skip


def test_the_studys_link_gives_the_studys_plant_and_rig(plant_of):
    plant, nominal = plant_of(STUDY_LINK), read_plant()
    for name, q in nominal.parameters.items():
        own = plant.parameters[name]
        assert (own.value, own.low, own.high) == pytest.approx((q.value, q.low, q.high)), name
    rig, own = rig_of_link(STUDY_LINK, "link.toml"), read_parameters()
    assert dict(rig) == pytest.approx(dict(own)) and rig.layout == own.layout


def test_every_value_stays_within_its_bounds_on_other_links(plant_of):
    for link in (SMALL, msgspec.structs.replace(SMALL, length_m=2.0, width_m=0.3, markers=None)):
        plant = plant_of(link)
        for q in plant.parameters.values():
            assert q.low <= q.value <= q.high, q.name
        for name, entry in rig_of_link(link, "link.toml").entries.items():
            assert entry.minimum <= entry.value <= entry.maximum, name


def test_a_plant_keeps_its_link_in_its_file(plant_of, tmp_path):
    plant = plant_of(SMALL)
    for suffix in ("json", "toml"):
        plant.write(tmp_path / f"plant.{suffix}")
        read = read_plant(tmp_path / f"plant.{suffix}")
        assert read.link == plant.link and read.sha256() == plant.sha256()


def test_a_hanging_link_is_bent_inwards_and_an_upright_one_outwards(plant_of):
    """Statics: at rest at +0.3 rad the weight lies beyond the joint upright, below it hanging."""
    deviation = {}
    for mounting in ("upright", "hanging"):
        link = msgspec.structs.replace(SMALL, gravity=LinkGravity(mounting=mounting))
        model = plant_of(link).step_model(1)
        y = model.simulate(np.tile([0.3, 0.1], (3, 1)), 0.017)
        tip_x = y[0, [v.name for v in model.outputs].index("tip_x_m")]
        deviation[mounting] = tip_x - 0.66 * np.sin(0.3)
    assert deviation["upright"] > 1e-3 and deviation["hanging"] < -1e-3


def test_the_index_of_a_plant_follows_the_places_of_the_markers(plant_of):
    """At a small bend the strain of an edge is in proportion to its distance from the axis."""
    half = MarkerLayout(
        SMALL.layout.rows_m, tuple((x / 2, y / 2) for x, y in SMALL.layout.corners_m)
    )
    found = []
    for layout in (SMALL.layout, half):
        plant = plant_of(msgspec.structs.replace(SMALL, markers=layout))
        plant = plant.with_values({"marker_noise_m": 0.0})
        model = plant.step_model(1)
        y = model.simulate(np.tile([0.3, 0.1], (3, 1)), 0.017)
        found.append(y[0, [v.name for v in model.outputs].index("di")])
    assert found[1] == pytest.approx(found[0] / 2, rel=1e-6) and found[0] > 1e-4


@pytest.mark.parametrize(
    ("gravity", "words"),
    [
        (LinkGravity(), "gravity, along -z"),
        (LinkGravity(mounting="horizontal"), "gravity, along -x"),
        (LinkGravity(mounting="hanging"), "gravity, along z"),
        (LinkGravity(direction=(0.0, 3.0, -4.0)), "gravity, along (0, 0.6, -0.8)"),
    ],
)
def test_gravity_is_described_as_the_link_is_mounted(plant_of, tmp_path, gravity, words):
    plant_of(msgspec.structs.replace(SMALL, gravity=gravity)).write(tmp_path / "plant.json")
    model = read_plant(tmp_path / "plant.json").step_model(1, "twin")
    assert [v.description for v in model.parameters if v.name == "gravity_m_s2"] == [words]
