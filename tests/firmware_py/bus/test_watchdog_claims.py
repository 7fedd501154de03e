"""Claims of docs and help texts about torque and watchdog, against the control tables."""

import math
import re
from pathlib import Path

import pytest

from dropstitch.__main__ import main
from firmware_py.bus.dynamixel import watchdog_steps
from firmware_py.bus.registers import WATCHDOG_STEP_S, Register
from firmware_py.bus.servo_models import MODELS
from firmware_py.config import UNWATCHED_RATE_RAD_S
from firmware_py.safety.limits import Limits
from firmware_py.signals import PERIOD_S

ROOT = Path(__file__).parents[3]
SAFETY = (ROOT / "docs" / "safety.md").read_text(encoding="utf-8")
WATCHED = {m.name for m in MODELS.values() if Register.BUS_WATCHDOG in m.table}
UNWATCHED = {m.name for m in MODELS.values()} - WATCHED


def rows():
    """The table of models in docs/safety.md: name, watchdog, behaviour without instructions."""
    section = SAFETY.split("## When the torque goes off")[1].split("\n## ")[0]
    return re.findall(r"^\| (\S+) \| (yes|no) \| (.+) \|$", section, re.MULTILINE)


def test_the_table_of_models_says_which_have_a_watchdog():
    assert {name for name, watchdog, _ in rows() if watchdog == "yes"} == WATCHED
    assert {name for name, watchdog, _ in rows() if watchdog == "no"} == UNWATCHED
    assert len(rows()) == len(MODELS)


def test_no_model_is_said_to_release_its_torque_by_itself():
    watchdog_ms = round(watchdog_steps(PERIOD_S) * WATCHDOG_STEP_S * 1e3)
    assert watchdog_ms == 60
    for _, watchdog, behaviour in rows():
        assert behaviour.endswith("torque on")
        assert (f"stops after {watchdog_ms} ms" in behaviour) == (watchdog == "yes")
        assert ("moves to its last goal" in behaviour) == (watchdog == "no")


def test_the_figures_of_the_text_are_those_of_the_code():
    assert f"limited to {UNWATCHED_RATE_RAD_S:g} rad/s" in SAFETY
    assert f"{Limits().following_error_rad:g} rad by default" in SAFETY
    assert math.isclose(watchdog_steps(PERIOD_S) * WATCHDOG_STEP_S, 0.060)


@pytest.mark.parametrize("name", ["docs/robot.md", "docs/safety.md", "README.md"])
def test_no_page_promises_that_a_servo_is_never_left_driven(name):
    assert not re.search(r"never\s+left\s+driven", (ROOT / name).read_text(encoding="utf-8"))


def test_the_help_of_run_says_what_sigkill_leaves_behind(capsys):
    assert main(["run", "--help"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "After SIGKILL or a power loss of the PC the torque stays on" in text
    assert "a legacy PRO (-R), which has none, moves to its last goal and holds it" in text
    assert "dropstitch release" in text


def test_legacy_names_are_told_apart_by_their_suffix():
    """The text calls the models without a watchdog `-R` without `(A)`."""
    assert {name for name in UNWATCHED if name.endswith("-R")} == UNWATCHED
    assert not any(name.endswith("-R") for name in WATCHED if name.startswith(("H54", "H42")))
