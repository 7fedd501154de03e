"""`dropstitch list`: effects, rigs and servos."""

import json

import pytest

from dropstitch.__main__ import main


@pytest.mark.parametrize(
    ("what", "line"),
    [
        ("effects", "backlash  rad  servo_torque  full backlash of the gear"),
        (
            "rigs",
            "chain  tuning  13 hinge pairs of the span, a box that wrinkles",
        ),
        ("servos", "XM430-W350  1020  4096  2.69  yes"),
    ],
)
def test_each_is_one_line(what, line, capsys):
    assert main(["list", what]) == 0
    assert line.split() in [shown.split() for shown in capsys.readouterr().out.splitlines()]


def test_the_list_as_data(capsys):
    assert main(["list", "effects", "--json"]) == 0
    effects = json.loads(capsys.readouterr().out)["effects"]
    assert effects["dead_time"]["unit"] == "s" and effects["dead_time"]["port"] == "command"
    assert "not in the rig" in effects["directional_friction"]["strength"]


def test_what_cannot_be_listed_is_bad_input(capsys):
    assert main(["list", "trials"]) == 2
    assert "choose from 'effects', 'rigs', 'servos'" in capsys.readouterr().err
