"""Commands of the guides: each is run on small data, or has a reason not to be.

That every command of every page is accepted by its own parser, and finds its files, is
`tests/house/test_page_commands.py`.
"""

from __future__ import annotations

import argparse
import shlex
import shutil

import pytest

from dropstitch.__main__ import main
from firmware_py.command_table import COMMANDS
from firmware_py.console import chosen_command
from models.trials.trial_files import write_trial
from tests.guides.how_commands_run import PARSED, RUN
from tests.house.each_file import ROOT
from tests.house.page_commands import PROGRAM, commands, parse

BUNDLE = ROOT / "docs" / "notebooks" / "bundle_1dof"


def own_commands() -> dict[str, tuple[str, list[str]]]:
    """Command as printed to its name, like "fmu build", and its arguments."""
    found = {}
    for page in sorted((ROOT / "docs" / "guides").glob("*.md")):
        for program, *arguments in commands(page.read_text(encoding="utf-8")):
            if program == PROGRAM:
                chosen = chosen_command(COMMANDS, arguments)
                assert chosen is not None, f"{page.name}: no command {arguments[0]}"
                found[shlex.join([program, *arguments])] = chosen.name, arguments
    return found


OWN = own_commands()


def is_run(line: str) -> bool:
    """Whether a command is run: a service is not installed, and there is no log to replay."""
    name, arguments = OWN[line]
    serves = name == "install-service" and "--dry-run" not in arguments
    return name in RUN and not serves and ".mcap" not in line


def test_each_command_is_run_or_has_a_reason_not_to_be():
    assert {name for name, _ in OWN.values()} == RUN.keys() | PARSED.keys()
    assert not RUN.keys() & PARSED.keys()
    assert {OWN[line][0] for line in OWN if is_run(line)} == RUN.keys()


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


@pytest.mark.parametrize("line", [line for line in OWN if is_run(line)])
def test_a_command_of_the_guides_runs(line, place, capsys):
    name, arguments = OWN[line]
    place(parse(arguments))
    code = main(arguments)
    said = capsys.readouterr()
    assert code in ((0, 1) if name == "doctor" else (0,)), said.err or said.out
    assert said.out.strip()
