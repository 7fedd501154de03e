"""Release files: the version is that of the changelog and of the citation."""

from __future__ import annotations

import re
from pathlib import Path

from ruamel.yaml import YAML

import firmware_py

ROOT = Path(__file__).resolve().parents[2]
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
