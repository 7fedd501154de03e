"""Commands of the guides: each is run on small data, or has a reason not to be.

That every command of every page is accepted by its own parser, and finds its files, is
`tests/house/test_page_commands.py`.
"""

from __future__ import annotations

import argparse
import importlib
import shlex
import shutil

import pytest

from models.trials.trial_files import write_trial
from tests.guides.how_commands_run import PARSED, RUN
from tests.house.each_file import ROOT
from tests.house.page_commands import PROGRAMS, commands, parse

BUNDLE = ROOT / "docs" / "notebooks" / "bundle_1dof"


def own_commands() -> dict[str, tuple[str, list[str]]]:
    """Command as printed to its name, like "dropstitch gap", and its arguments."""
    found = {}
    for page in sorted((ROOT / "docs" / "guides").glob("*.md")):
        for words in commands(page.read_text(encoding="utf-8")):
            line = shlex.join(words)
            for program in PROGRAMS:
                if line.startswith(f"{program} "):
                    arguments = words[len(program.split()) :]
                    found[line] = f"{program.split()[-1]} {arguments[0]}", arguments
    return found


OWN = own_commands()


def is_run(line: str) -> bool:
    """Whether a command is run: a service is not installed, and there is no log to replay."""
    name, arguments = OWN[line]
    serves = name == "dropstitch install-service" and "--dry-run" not in arguments
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
    program = next(p for p in PROGRAMS if p.split()[-1] == name.split()[0])
    place(parse(PROGRAMS[program], arguments))
    code = importlib.import_module(PROGRAMS[program]).main(arguments)
    said = capsys.readouterr()
    assert code in ((0, 1) if name == "dropstitch doctor" else (0,)), said.err or said.out
    assert said.out.strip()
