"""Commands of the guides that are quick, run as they stand on small data."""

import argparse
import shlex
import shutil

import pytest

from dropstitch.__main__ import main
from models.trials.files import write_trial
from tests.house.page_commands import PROGRAM, commands, parse
from tests.house.sources import ROOT

BUNDLE = ROOT / "docs" / "notebooks" / "bundle_1dof"


QUICK = {"new", "evaluate", "validate", "sign", "replay", "install-service", "doctor"}


def quick_commands() -> dict[str, list[str]]:
    """Command as printed to its arguments; a service is not installed, and there is no log."""
    found = {}
    docs = ROOT / "docs"
    for page in [*sorted((docs / "guides").glob("*.md")), docs / "plant" / "link.md"]:
        for program, *arguments in commands(page.read_text(encoding="utf-8")):
            line = shlex.join([program, *arguments])
            if program != PROGRAM or arguments[0] not in QUICK or ".mcap" in line:
                continue
            if arguments[0] != "install-service" or "--dry-run" in arguments:
                found[line] = arguments
    return found


QUICK_COMMANDS = quick_commands()


@pytest.fixture
def place(tmp_path, monkeypatch, toy_trials):
    """Function that puts small data where a command looks for it, in a directory of its own."""
    monkeypatch.chdir(tmp_path)
    shutil.copy(ROOT / "robot.toml", tmp_path)
    shutil.copytree(BUNDLE, tmp_path / "build" / "bundle_1dof")
    (tmp_path / "models").symlink_to(ROOT / "models")

    def put(args: argparse.Namespace) -> None:
        if (trials := getattr(args, "trials", None)) and not trials.exists():
            one = toy_trials(1, amplitudes_deg=(30,), trials=(1,), payloads_kg=(1.0,))[0]
            write_trial(one, trials)
        if (plant := getattr(args, "plant", None)) and not plant.exists():
            shutil.copy(BUNDLE / "plant.json", plant)

    return put


@pytest.mark.parametrize("line", QUICK_COMMANDS)
def test_a_command_of_the_guides_runs(line, place, capsys):
    arguments = QUICK_COMMANDS[line]
    place(parse(arguments))
    code = main(arguments)
    output = capsys.readouterr()
    # The verdict of doctor is about this machine.
    assert code in ((0, 1) if arguments[0] == "doctor" else (0,)), output.err or output.out
    assert output.out.strip()
