"""The file of a link: read, written, refused."""

import math

import msgspec
import pytest

from firmware_py.core.errors import InputError
from firmware_py.link.link_description import (
    STUDY_LINK,
    LinkDescription,
    LinkGravity,
    LinkServo,
    check_link,
    link_toml,
    read_link,
)
from firmware_py.link.marker_layout import MarkerLayout, square_layout

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
    ("change", "said"),
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
def test_what_cannot_be_is_refused(change, said):
    with pytest.raises(InputError) as caught:
        check_link(msgspec.structs.replace(SMALL, **change), "link.toml")
    assert said in str(caught.value)


@pytest.mark.parametrize(
    "key", ["length_m", "width_m", "base_offset_m", "pressure_pa", "payload_kg"]
)
def test_a_number_that_is_left_out_is_not_the_studys(tmp_path, key):
    path, lines = tmp_path / "link.toml", link_toml(SMALL, 0.4, 0.1).splitlines()
    path.write_text("\n".join(line for line in lines if not line.startswith(key)))
    with pytest.raises(InputError, match=f"{key} is missing; give that of your link"):
        read_link(path)
