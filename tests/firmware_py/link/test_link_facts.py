"""Facts of links: of a plant, of a bundle, and the first in which two links differ."""

import json

import msgspec
import pytest

from firmware_py.link.link_facts import STUDY_FACTS, facts_of_bundle, facts_of_plant, other_link
from models.plant.plant import read_plant


def plain(path):
    return json.loads(path.read_text())


@pytest.fixture
def plant(tmp_path):
    read_plant().write(tmp_path / "plant.json")
    return plain(tmp_path / "plant.json")


def test_the_nominal_plant_is_of_the_studys_link(plant, tmp_path):
    assert facts_of_plant(plant) == STUDY_FACTS
    assert facts_of_bundle(tmp_path) == STUDY_FACTS
    assert facts_of_bundle(tmp_path / "elsewhere") is None


def test_a_described_link_tells_its_mounting_and_its_servo(tmp_path):
    text = "length_m = 0.6\nwidth_m = 0.1\nbase_offset_m = 0.06\npressure_pa = 20700\n"
    text += 'payload_kg = 0.1\njoints = 1\n[gravity]\nmounting = "hanging"\n'
    (tmp_path / "link.toml").write_text(text + '[servo]\nmodel = "XM430-W350"\n')
    read_plant(tmp_path / "link.toml").write(tmp_path / "plant.json")
    found = facts_of_plant(plain(tmp_path / "plant.json"))
    assert (found.joints, found.length_m, found.width_m) == (1, 0.6, 0.1)
    assert found.gravity_m_s2 == pytest.approx((0.0, 0.0, 9.81))
    assert found.servo == "XM430-W350"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"length_m": 0.6}, "length_m 0.6 in place of 0.95"),
        ({"joints": 1}, "joints 1 in place of 2"),
        ({"gravity_m_s2": (0.0, 0.0, 9.81)}, "gravity_m_s2 [0, 0, 9.81] in place of [0, 0, -9.81]"),
        ({"servo": "XM430-W350"}, "servo XM430-W350 in place of H54-200-S500-R"),
        ({"length_m": 0.95 + 1e-9}, ""),
    ],
)
def test_the_first_fact_that_differs_is_named(change, said):
    assert other_link(msgspec.structs.replace(STUDY_FACTS, **change), STUDY_FACTS) == said


@pytest.mark.parametrize("damage", [{}, {"parameters": 3}, {"link": 3}, {"link": {"joints": 9}}])
def test_what_is_no_link_has_no_facts(plant, damage):
    assert facts_of_plant({} if not damage else plant | damage) is None
