"""The file of a link: read, written, refused, compared; and the robot whose file names it."""

import json
import math

import msgspec
import pytest

from firmware_py.config import read_config
from firmware_py.core.errors import InputError
from firmware_py.link.link_description import (
    STUDY_LINK,
    LinkDescription,
    LinkGravity,
    LinkServo,
    check_link,
    read_link,
)
from firmware_py.link.link_facts import STUDY_FACTS, facts_of_plant, other_link
from firmware_py.link.marker_layout import MarkerLayout, square_layout
from models.commands.new import link_toml
from models.plant.plant import read_plant

SMALL = LinkDescription(
    name='a "small" link', length_m=0.6, width_m=0.1, payload_kg=0.1, joints=1,
    markers=square_layout(0.6, 0.1, rows=3), servo=LinkServo(model="XM430-W350"),
    gravity=LinkGravity(mounting="hanging", effective_weight=0.5),
)  # fmt: skip


def test_a_written_link_is_read_as_it_was(tmp_path):
    path = tmp_path / "link.toml"
    path.write_text(link_toml(SMALL, 0.4, 0.1), encoding="utf-8")
    read = read_link(path)
    assert msgspec.structs.replace(read, servo=SMALL.servo) == SMALL
    assert read.preset == SMALL.preset and read.servo.model == "XM430-W350"


def test_weight_falls_along_the_mounting():
    for mounting, direction in (("upright", -1.0), ("hanging", 1.0)):
        gravity = LinkGravity(mounting=mounting, effective_weight=0.4)
        assert gravity.vector_m_s2 == pytest.approx((0.0, 0.0, direction * 0.4 * 9.81))
    assert math.hypot(*LinkGravity(direction=(3.0, 0.0, 4.0)).unit) == pytest.approx(1.0)
    assert STUDY_LINK.gravity.vector_m_s2 == (0.0, 0.0, -9.81)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"length_m": 60.0}, "length_m is 60"),
        ({"markers": MarkerLayout((0.2, 0.1, 0.6), ((0.0, 0.0),))}, "do not ascend"),
        ({"markers": MarkerLayout((0.2, 0.4), ((0.0, 0.0),))}, "the link ends at 0.6 m"),
        ({"markers": MarkerLayout((0.6,), ((0.1, 0.0),))}, "do not surround the axis"),
        ({"gravity": LinkGravity(direction=(0.0, 0.0, 0.0))}, "has no direction"),
        ({"gravity": LinkGravity(effective_weight=1.5)}, "effective_weight is 1.5"),
        ({"servo": LinkServo(model="XM431")}, "'XM431' is not known"),
        ({"servo": LinkServo(torque_constant_nm_a=1783.0)}, "is 1783 N.m/A, outside 0.003 to 700"),
        ({"servo": LinkServo(rotor_inertia_kg_m2=3.6e-7)}, "give it in kg.m2, at the output"),
        ({"servo": LinkServo(mass_kg=math.nan)}, "servo.mass_kg is nan kg"),
        ({"payload_kg": 100.0}, "payload_kg is 100, whose weight takes"),
        ({"markers": square_layout(0.6, 1.0)}, "reach 0.5 m from the axis, the link is 0.1 m wide"),
    ],
)
def test_a_link_that_cannot_be_is_refused(change, words):
    with pytest.raises(InputError) as refused:
        check_link(msgspec.structs.replace(SMALL, **change), "link.toml")
    assert words in str(refused.value)


@pytest.mark.parametrize(
    "key", ["length_m", "width_m", "base_offset_m", "pressure_pa", "payload_kg"]
)
def test_a_missing_number_is_refused_instead_of_taken_from_the_study(tmp_path, key):
    path, lines = tmp_path / "link.toml", link_toml(SMALL, 0.4, 0.1).splitlines()
    path.write_text("\n".join(line for line in lines if not line.startswith(key)))
    with pytest.raises(InputError, match=f"{key} is missing; give that of your link"):
        read_link(path)


# --- facts that two links are compared by -------------------------------------------------------


def plant_of(directory, link=None):
    """JSON document of the nominal plant of a link, which lies in the directory."""
    read_plant(*[link] if link else []).write(directory / "plant.json")
    return json.loads((directory / "plant.json").read_text())


def test_facts_are_those_of_the_link_of_a_plant(tmp_path):
    assert facts_of_plant({}) is None
    assert facts_of_plant(plant_of(tmp_path)) == STUDY_FACTS
    (tmp_path / "link.toml").write_text(link_toml(SMALL, 0.4, 0.1), encoding="utf-8")
    facts = facts_of_plant(plant_of(tmp_path, tmp_path / "link.toml"))
    assert (facts.joints, facts.length_m, facts.width_m) == (1, 0.6, 0.1)
    assert facts.gravity_m_s2 == pytest.approx((0.0, 0.0, 0.5 * 9.81))
    assert facts.servo == "XM430-W350"
    assert other_link(facts, STUDY_FACTS).startswith("joints 1 ")
    nearly = msgspec.structs.replace(STUDY_FACTS, length_m=0.95 + 1e-9)
    assert other_link(nearly, STUDY_FACTS) == ""


@pytest.mark.parametrize("damage", [{"parameters": 3}, {"link": 3}, {"link": {"joints": 9}}])
def test_a_document_without_a_link_has_no_facts(tmp_path, damage):
    assert facts_of_plant(plant_of(tmp_path) | damage) is None
    assert facts_of_plant({}) is None


# --- a robot whose configuration names its link -------------------------------------------------

SERVO = '[[servos]]\nid = {}\nmodel = "XM430-W350"\n'
ROBOT = 'bundle = "b"\nlink = "link.toml"\n[bus]\nport = "p"\n' + SERVO.format(1)
LINK = """
length_m = 2.0
width_m = 0.1
base_offset_m = 0.06
pressure_pa = 20700
payload_kg = 0.1
joints = 1
[servo]
model = "XM430-W350"
"""


def read(folder, robot=ROBOT, link=LINK):
    (folder / "link.toml").write_text(link)
    (folder / "robot.toml").write_text(robot)
    return read_config(folder / "robot.toml")


def test_the_limits_of_a_robot_follow_its_link(tmp_path):
    limits = read(tmp_path).limits
    assert min(limits.tip_max_m) > 2.06 and max(limits.tip_min_m) < -2.06
    assert limits.current_a <= 2.3 and limits.rate_rad_s == 2.0
    slow = read(tmp_path, link=LINK + "speed_limit_rad_s = 0.7\n").limits
    assert slow.rate_rad_s == 0.7
    set_ = read(tmp_path, ROBOT + "[limits]\ncurrent_a = 3.0\ntip_max_m = [1.0, 1.0, 1.0]\n").limits
    assert set_.current_a == 3.0 and set_.tip_max_m == (1.0, 1.0, 1.0)


@pytest.mark.parametrize(
    ("robot", "link", "words"),
    [
        (ROBOT.replace("XM430-W350", "H54-200-S500-R"), LINK, "is not the link's XM430-W350"),
        (ROBOT + SERVO.format(2), LINK, "the link 1 joint"),
        (ROBOT, LINK.replace("= 2.0", "= 200"), "length_m is 200"),
    ],
)
def test_a_robot_with_another_link_is_refused(tmp_path, robot, link, words):
    with pytest.raises(InputError) as refused:
        read(tmp_path, robot, link)
    assert words in str(refused.value)
