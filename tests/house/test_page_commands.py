"""Commands of README.md and of docs, as printed: their parsers accept them."""

import re
from importlib.util import find_spec

import pytest

from firmware_py.commands.command_table import COMMANDS
from firmware_py.core.console import chosen_command
from tests.house.page_commands import commands, objection, targets_of_make
from tests.house.sources import ROOT

TEXTS = {
    str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
    for path in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(ROOT.glob("docs/**/*.md"))]
}


@pytest.mark.parametrize("page", [page for page, text in TEXTS.items() if "```sh\n" in text])
def test_every_command_of_a_page_runs_as_printed(page):
    checked = [(" ".join(words), objection(words)) for words in commands(TEXTS[page])]
    assert not [pair for pair in checked if pair[1]]


def test_commands_that_the_prose_names_are_there():
    """Targets of make, commands of dropstitch and benchmarks, between backticks."""
    missing = []
    for page, text in TEXTS.items():
        for program, word, second in re.findall(
            r"`(make|dropstitch|python -m) (\w[\w./-]*)(?: ([a-z]+))?", text
        ):
            known = {
                "make": word in targets_of_make() or "/" in word,
                "dropstitch": "COMMAND" in word or chosen_command(COMMANDS, [word, second]),
                "python -m": not word.startswith("bench.") or find_spec(word),
            }
            if not known[program]:
                missing.append(f"{page}: {program} {word}")
    assert not missing, "\n".join(missing)
