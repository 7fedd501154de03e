"""Configuration: defaults of the commented robot.toml, and refusals of wrong input."""

import re
import tomllib
from pathlib import Path

import msgspec
import numpy as np
import pytest

from firmware_py.config import RobotConfig, read_config
from firmware_py.core.errors import InputError

EXAMPLE = Path(__file__).parents[2] / "robot.toml"

MINIMAL = """
bundle = "bundle"
[bus]
port = "/dev/ttyUSB0"
[[servos]]
id = 1
model = "H54-200-S500-R"
"""

SERVO = """
[[servos]]
id = {}
model = "H54-200-S500-R"
"""


def config_of(text, tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(text, encoding="utf-8")
    return read_config(path)


def uncommented(text):
    """The example with its commented-out keys put in force."""
    return re.sub(r"^# (?=\w+ = |\[\[)", "", text, flags=re.MULTILINE)


def test_the_example_is_right_and_its_values_are_the_defaults(tmp_path):
    example = read_config(EXAMPLE)
    minimal = config_of(MINIMAL, tmp_path)
    assert (
        msgspec.structs.replace(
            minimal, bundle=example.bundle, bus=example.bus, servos=example.servos
        )
        == example
    )
    assert minimal.bus == msgspec.structs.replace(example.bus, port="/dev/ttyUSB0")


@pytest.mark.parametrize(("model", "most_s"), [("H54-200-S500-R", 1.0), ("XM430-W350", 0.846)])
def test_the_period_is_at_most_what_the_watchdog_of_the_servos_can_wait(tmp_path, model, most_s):
    text = MINIMAL.replace("H54-200-S500-R", model) + "[motion]\namplitude_rad = 0.01\n"
    assert config_of(f"period_s = {most_s}\n" + text, tmp_path).period_s == most_s
    with pytest.raises(InputError, match="period_s"):
        config_of(f"period_s = {most_s + 0.001}\n" + text, tmp_path)


def test_the_example_shows_every_key():
    def keys(struct, prefix=""):
        for field in msgspec.structs.fields(struct):
            name = f"{prefix}{field.name}"
            inner = field.type
            if name == "servos":
                inner = field.type.__args__[0]
            yield name
            if isinstance(inner, type) and issubclass(inner, msgspec.Struct):
                yield from keys(inner, f"{name}.")

    document = tomllib.loads(uncommented(EXAMPLE.read_text(encoding="utf-8")))
    shown = set(document)
    for name, table in document.items():
        for part in table if isinstance(table, list) else [table]:
            if isinstance(part, dict):
                shown |= {f"{name}.{key}" for key in part}
    assert shown == set(keys(RobotConfig))


WRONG = {
    "unknown key": (MINIMAL + "[limts]\n", "limts"),
    "unknown key in a table": (MINIMAL.replace("port", "baudd = 1\nport"), r"baudd.*\$\.bus"),
    "missing key": (MINIMAL.replace("port", "# port"), r"port.*\$\.bus"),
    "wrong type": (MINIMAL.replace("id = 1", "id = 'one'"), r"int.*servos"),
    "no TOML": (MINIMAL + "[bus", "is not TOML"),
    "another schema": ("schema = 2\n" + MINIMAL, "schema is 2"),
    "unknown servo": (MINIMAL.replace("H54-200", "H55-200"), "XM430-W350"),
    "three servos": (MINIMAL + SERVO.format(2) + SERVO.format(3), "3 entries"),
    "one id twice": (MINIMAL + "[[servos]]\nid = 1\nmodel = 'H54-200-S500-R'\n", r"\[1, 1\]"),
    "odd baud rate": (MINIMAL.replace("[bus]", "[bus]\nbaud = 1000"), "1000000"),
    "too slow a bus": (MINIMAL.replace("[bus]", "[bus]\nbaud = 57600"), "need 10.4 ms"),
    "a period of zero": ("period_s = 0.0\n" + MINIMAL, "period_s is 0 s"),
    "limits the wrong way round": (MINIMAL + "[limits]\nangle_rad = [0.5, -0.5]\n", "low < high"),
    "a tip box without room": (MINIMAL + "[limits]\ntip_min_m = [0, 0, 2]\n", "along z"),
    "not a number": (MINIMAL + "[limits]\nrate_rad_s = nan\n", "rate_rad_s is nan"),
    "a time-out beyond the period": (
        MINIMAL.replace("[bus]", "[bus]\nreply_timeout_s = 0.1"), "reply_timeout_s",
    ),
    "an unknown motion": (MINIMAL + "[motion]\nkind = 'circle'\n", "circle"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_file_is_refused_naming_file_and_key(case, tmp_path):
    text, words = WRONG[case]
    with pytest.raises(InputError, match=words) as error:
        config_of(text, tmp_path)
    assert "robot.toml" in str(error.value) or "servo model" in str(error.value)
    assert len(str(error.value).splitlines()) == 1


def test_a_repeated_motion_comes_back_to_where_it_starts(tmp_path):
    text = MINIMAL + (
        "[[servos]]\nid = 2\nmodel = 'H54-200-S500-R'\n[motion]\nphase_2_rad = 1.5707963\n"
    )
    goals = config_of(text, tmp_path).goals_rad(repeated=True)
    steps = np.abs(np.diff(np.vstack([goals, goals[:1]]), axis=0))
    assert steps.max() < 2.0 * 0.017
    assert np.abs(goals[-1]).max() < 1e-3


def test_a_motion_beyond_the_limits_is_refused(tmp_path):
    config = config_of(MINIMAL + "[motion]\namplitude_rad = 0.7\n", tmp_path)
    with pytest.raises(InputError, match="motion sinusoid: the goal of joint 1"):
        config.goals_rad()


@pytest.mark.parametrize(
    ("model", "limited"), [("H54-200-S500-R", True), ("H54-200-S500-R(A)", False)]
)
def test_servos_without_a_watchdog_are_driven_more_slowly(tmp_path, model, limited):
    path = tmp_path / "robot.toml"
    path.write_text(MINIMAL.replace("H54-200-S500-R", model))
    config = read_config(path)
    rate_rad_s = 1.0 if limited else config.limits.rate_rad_s
    assert config.limits_in_force.rate_rad_s == rate_rad_s
    assert {setup.max_rate_rad_s for setup in config.setups()} == {rate_rad_s}


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ("payload_kg = -1.0", "payload_kg is -1 kg; give a mass from 0 to 100 kg."),
        ("[limits]\nrate_rad_s = 0.0", "limits.rate_rad_s is 0 rad/s; give 0.001 to 100 rad/s."),
        ("[limits]\nstale_ticks = 0", "limits.stale_ticks is 0; give 1 to 100."),
    ],
)
def test_a_value_beyond_its_range_is_told_with_its_unit(tmp_path, line, sentence):
    text = MINIMAL + line if line.startswith("[") else line + MINIMAL
    with pytest.raises(InputError) as refused:
        config_of(text, tmp_path)
    assert str(refused.value) == f"{tmp_path / 'robot.toml'}: {sentence}"
