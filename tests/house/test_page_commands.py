"""Commands of README.md and of docs, as printed: parsers accept them, their files exist."""

import re
from importlib.util import find_spec

import pytest

from firmware_py.commands.command_table import COMMANDS
from firmware_py.core.console import chosen_command
from tests.house.page_commands import PageCommands, blocks, commands, targets_of_make
from tests.house.sources import ROOT

PAGES = sorted(
    str(path.relative_to(ROOT))
    for path in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]
    if blocks(path.read_text(encoding="utf-8"))
)
OWN_FILES = {
    "docs/gap.md": ("build/new_trials",),
    "docs/gap/real-data.md": ("DATA/bam_xl330",),
    "docs/guides/deploy.md": ("run.mcap", "map.toml", "logs"),
    "docs/guides/own-mocap.md": ("take_001.csv", "takes", "run.mcap", "map.toml"),
    "docs/robot.md": ("motion.toml",),
    "docs/trials.md": ("take.csv", "servo.csv", "run.mcap", "map.toml"),
}
"""By page: what stands for the reader's own file."""


@pytest.mark.parametrize("page", PAGES)
def test_every_command_of_a_page_runs_as_printed(page):
    check = PageCommands(OWN_FILES.get(page, ()))
    failures = []
    for words in commands((ROOT / page).read_text(encoding="utf-8")):
        try:
            check.check(words)
        except AssertionError as error:
            failures.append(str(error).splitlines()[0])
    assert not failures, "\n".join(failures)


def test_commands_that_the_prose_names_are_there():
    """Targets of make, commands of dropstitch and benchmarks, between backticks."""
    missing = []
    for page in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]:
        text = page.read_text(encoding="utf-8")
        for program, word, second in re.findall(
            r"`(make|dropstitch|python -m) (\w[\w./-]*)(?: ([a-z]+))?", text
        ):
            known = {
                "make": word in targets_of_make() or "/" in word,
                "dropstitch": "COMMAND" in word or chosen_command(COMMANDS, [word, second]),
                "python -m": not word.startswith("bench.") or find_spec(word),
            }
            if not known[program]:
                missing.append(f"{page.relative_to(ROOT)}: {program} {word}")
    assert not missing, "\n".join(missing)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("dropstitch plan circle --plant build/plant.json --out x.json", "parser refuses"),
        ("dropstitch evaluate build/trails --plant build/plant.json", "makes build/trails"),
        ("dropstitch emulat", "parser refuses"),
        ("make dmeo", "no target"),
        ("python -m bench.onyx", "no module"),
        ("pip install 'dropstitch[live,recorder]'", "no extra {'recorder'}"),
        ("scp requirements/robots.txt robot-pc:", "nothing makes"),
        ("wget x", "no known program"),
    ],
)
def test_a_command_that_would_fail_is_named(line, words):
    (command,) = commands(f"```sh\n{line}   # as printed\n```\n")
    with pytest.raises(AssertionError, match=words):
        PageCommands().check(command)
