"""Architecture page: its tree, walks and glossary against the code."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
ROOMS = ("firmware_py", "models", "fmu", "hil")
PACKAGES = (*ROOMS, "dropstitch")
NOT_LISTED = {"c"}
"""Folders that the page names with their parent."""


def section(title):
    return re.split(r"\n##+ ", PAGE.split(f"\n## {title}\n")[1])[0]


def folders_of_the_page():
    """Paths of the tree, from the indentation of its lines."""
    found, parents = set(), {}
    for line in section("Rooms and arrows").split("```")[1].splitlines():
        if match := re.match(r"( *)([\w-]+)/", line):
            depth = len(match[1]) // 2
            parents[depth] = match[2]
            found.add("/".join(parents[d] for d in range(depth + 1)))
    return found


def test_the_tree_is_that_of_the_rooms():
    code = {
        str(folder.relative_to(ROOT))
        for room in PACKAGES
        for folder in [ROOT / room, *(ROOT / room).rglob("*")]
        if folder.is_dir() and any(f.is_file() for f in folder.iterdir())
        and "__pycache__" not in folder.parts and folder.name not in NOT_LISTED
    }  # fmt: skip
    page = {f for f in folders_of_the_page() if f.split("/")[0] in PACKAGES}
    named = {f for f in code if f"{f.rsplit('/', 1)[-1]}/ " in PAGE}  # in the words of a parent
    assert page <= code
    assert code - page <= named


def walks():
    """Title of each walk to its files, in order."""
    text = section("Data flow").split("Five walks")[1]
    parts = re.split(r"^\*\*(.+)\.\*\*$", text, flags=re.MULTILINE)[1:]
    return {
        title: re.findall(r"^\d+\. `([\w./]+)`", body, re.MULTILINE)
        for title, body in zip(parts[::2], parts[1::2], strict=True)
    }


def test_the_walks_pass_each_file_once():
    assert len(walks()) == 5
    for title, files in walks().items():
        assert len(files) >= 5, title
        assert len(set(files)) == len(files), title
        assert all((ROOT / file).is_file() for file in files), title


def test_the_glossary_is_short_and_explains_each_word_once():
    text = section("Glossary").strip().splitlines()
    assert len(text) <= 44
    words = [w for line in text[2:] for w in line.split("|")[1].strip().split(", ")]
    assert len(set(words)) == len(words)
