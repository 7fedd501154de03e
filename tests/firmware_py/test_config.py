"""Configuration: defaults of the commented robot.toml, and refusals of wrong input."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from firmware_py.config import read_config
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


def config_of(text, tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(text, encoding="utf-8")
    return read_config(path)


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


def second_servo(id_=2):
    return f'[[servos]]\nid = {id_}\nmodel = "H54-200-S500-R"\n'


WRONG = {
    "unknown key": (MINIMAL + "[limts]\n", "limts"),
    "unknown key in a table": (MINIMAL.replace("port", "baudd = 1\nport"), r"baudd.*\$\.bus"),
    "missing key": (MINIMAL.replace("port", "# port"), r"port.*\$\.bus"),
    "wrong type": (MINIMAL.replace("id = 1", "id = 'one'"), r"int.*servos"),
    "unknown servo": (
        MINIMAL + second_servo().replace("H54", "H5x"),
        r"robot.toml: servos\[1\].model is 'H5x-.*XM430-W350",
    ),
    "no TOML": (MINIMAL + "[bus", "is not TOML"),
    "another schema": ("schema = 2\n" + MINIMAL, "schema is 2"),
    "three servos": (MINIMAL + second_servo(2) + second_servo(3), "3 entries"),
    "one id twice": (MINIMAL + second_servo(1), r"\[1, 1\]"),
    "a baud rate that no servo has": (MINIMAL.replace("[bus]", "[bus]\nbaud = 1000"), "1000000"),
    "too slow a bus": (MINIMAL.replace("[bus]", "[bus]\nbaud = 57600"), "need 10.4 ms"),
    "a period of zero": ("period_s = 0.0\n" + MINIMAL, "period_s is 0 s"),
    "limits the wrong way round": (MINIMAL + "[limits]\nangle_rad = [0.5, -0.5]\n", "low < high"),
    "a tip box without room": (MINIMAL + "[limits]\ntip_min_m = [0, 0, 2]\n", "along z"),
    "not a number": (MINIMAL + "[limits]\nrate_rad_s = nan\n", "rate_rad_s is nan"),
    "a time-out beyond the period": (
        MINIMAL.replace("[bus]", "[bus]\nreply_timeout_s = 0.1"), "reply_timeout_s",
    ),
    "a negative payload": ("payload_kg = -1.0" + MINIMAL, "payload_kg is -1 kg; give"),
    "a rate of zero": (MINIMAL + "[limits]\nrate_rad_s = 0.0", r"limits\.rate_rad_s is 0 rad/s"),
    "no stale ticks": (MINIMAL + "[limits]\nstale_ticks = 0", r"limits\.stale_ticks is 0; give"),
    "a processor below zero": (MINIMAL + "[real_time]\ncpu = -1", r"real_time\.cpu"),
    "a path with a NUL": (MINIMAL.replace('"bundle"', r'"a\u0000b"'), "bundle"),
    "a path with a line break": ('logs = "a\\nb"\n' + MINIMAL, "logs"),
    "a port with an escape": (MINIMAL.replace("/dev/tty", r"/dev/\u001b[0m"), r"bus\.port"),
    "a key that is none": (MINIMAL + "[trust]\nkeys = ['ed25519:AAAA']\n", "is no public key"),
    "an RSA key": (MINIMAL + f"[trust]\nkeys = ['rsa:{43 * 'A'}=']\n", "is no public key"),
    "a reversed legacy servo": (MINIMAL + "reverse = true\n", "has no Drive Mode"),
    "a gain that the servo lacks": (MINIMAL + "gains = { position_d = 1 }\n", "no Position D Gain"),
    "an offset beyond a turn": (MINIMAL + "homing_offset_rad = 4.0\n", "homing_offset_rad is 4"),
    "a negative amplitude": (MINIMAL + "[motion]\namplitude_rad = -1", r"motion\.amplitude_rad is"),
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
    text = MINIMAL + second_servo() + "[motion]\nphase_2_rad = 1.5707963\n"
    goals = config_of(text, tmp_path).goals_rad(repeated=True)
    steps = np.abs(np.diff(np.vstack([goals, goals[:1]]), axis=0))
    assert steps.max() < 2.0 * 0.017
    assert np.abs(goals[-1]).max() < 1e-3


@pytest.mark.parametrize(
    "table",
    ["[motion]\namplitude_rad = 0.7\n", "[limits]\nangle_rad = [0.1, 0.6]\n"],
    ids=["too large", "starts outside"],
)
def test_a_motion_beyond_the_limits_is_refused(tmp_path, table):
    config = config_of(MINIMAL + table, tmp_path)
    with pytest.raises(InputError, match="motion sinusoid: the goal of joint 1"):
        config.goals_rad()


@pytest.mark.parametrize(
    ("model", "limited"), [("H54-200-S500-R", True), ("H54-200-S500-R(A)", False)]
)
def test_servos_without_a_watchdog_are_driven_more_slowly(tmp_path, model, limited):
    config = config_of(MINIMAL.replace("H54-200-S500-R", model), tmp_path)
    rate_rad_s = 1.0 if limited else config.limits.rate_rad_s
    assert config.limits_in_force.rate_rad_s == rate_rad_s
    assert {setup.max_rate_rad_s for setup in config.setups()} == {rate_rad_s}
