"""Release files: the version of changelog and citation, the figures of README."""

from __future__ import annotations

import json
import re

from ruamel.yaml import YAML

import firmware_py
from bench.figures import DOCUMENT, README, README_FIGURES, readme_block
from tests.house.sources import ROOT

RELEASES = re.findall(
    r"^## \[(\d+\.\d+\.\d+)\] - (\d{4}-\d{2}-\d{2})$",
    (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE,
)  # fmt: skip


def test_the_version_is_the_newest_release_of_the_changelog():
    assert firmware_py.__version__ == RELEASES[0][0]


def test_the_citation_is_valid_and_names_this_version():
    """Required keys of the Citation File Format 1.2.0."""
    citation = YAML(typ="safe").load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert {"authors", "cff-version", "message", "title"} <= citation.keys()
    assert (citation["version"], citation["date-released"]) == RELEASES[0]


def test_readme_states_the_measured_figures():
    block = readme_block(json.loads(DOCUMENT.read_text(encoding="utf-8")))
    assert len(block.splitlines()) == 2 + len(README_FIGURES)
    assert block in README.read_text(encoding="utf-8")
