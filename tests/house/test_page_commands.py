"""Commands of README.md and of docs, as printed: parsers accept them, their files exist."""

import pytest

from tests.house.each_file import ROOT
from tests.house.page_commands import PageCommands, blocks, commands

PAGES = sorted(
    str(path.relative_to(ROOT))
    for path in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]
    if blocks(path.read_text(encoding="utf-8"))
)
OWN_FILES = {
    "docs/gap.md": ("build/gap_trials",),
    "docs/gap/experiment.md": ("build/gap", "build/gap_trials", "build/new_trials"),
    "docs/gap/real-data.md": ("DATA/bam_xl330",),
    "docs/guides/deploy.md": ("run.mcap", "map.toml", "logs"),
    "docs/guides/missing-effect.md": ("build/new_trials",),
    "docs/guides/own-mocap.md": ("take_001.csv", "takes", "run.mcap", "map.toml"),
    "docs/robot.md": ("run.mcap", "take_001.csv", "map.toml", "motion.toml", "logs"),
    "docs/tip/learning.md": ("run1",),
    "docs/trials.md": ("take.csv", "run.mcap", "map.toml"),
}
"""By page: what stands for the reader's own file."""


@pytest.mark.parametrize("page", PAGES)
def test_every_command_of_a_page_can_be_given_as_printed(page):
    check = PageCommands(OWN_FILES.get(page, ()))
    failures = []
    for words in commands((ROOT / page).read_text(encoding="utf-8")):
        try:
            check.check(words)
        except AssertionError as error:
            failures.append(str(error).splitlines()[0])
    assert not failures, "\n".join(failures)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("python -m models plan circle --plant build/plant.json --out x.json", "parser refuses"),
        ("python -m models evaluate build/trails --plant build/plant.json", "makes build/trails"),
        ("python -m hil emulat", "parser refuses"),
        ("make dmeo", "no target"),
        ("python -m bench.onyx", "no module"),
        ("pip install 'dropstitch[live,recorder]'", "no extra {'recorder'}"),
        ("scp requirements/robots.txt robot-pc:", "nothing makes"),
        ("wget x", "no known program"),
    ],
)
def test_a_command_that_would_fail_is_named(line, said):
    (words,) = commands(f"```sh\n{line}   # as printed\n```\n")
    with pytest.raises(AssertionError, match=said):
        PageCommands().check(words)
