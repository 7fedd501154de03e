"""Release files: version, changelog, citation and pre-commit hooks agree with the project."""

from __future__ import annotations

import datetime
import re
import tomllib
from pathlib import Path

from ruamel.yaml import YAML

import firmware_py

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
RELEASES = re.findall(
    r"^## \[(\d+\.\d+\.\d+)\] - (\d{4}-\d{2}-\d{2})$",
    (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE,
)  # fmt: skip


def read_yaml(name):
    return YAML(typ="safe").load((ROOT / name).read_text(encoding="utf-8"))


def test_the_changelog_keeps_its_form():
    headings = re.findall(r"^##+ (.+)$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    groups = {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}
    assert all(h.startswith("[") or h in groups for h in headings)
    days = [datetime.date.fromisoformat(day) for _, day in RELEASES]
    assert days == sorted(days, reverse=True)


def test_the_version_has_one_source():
    assert PROJECT["dynamic"] == ["version"]
    assert firmware_py.__version__ == RELEASES[0][0]


def test_the_citation_names_this_version_and_the_study():
    """Required keys of the Citation File Format 1.2.0, and what they must say."""
    citation = read_yaml("CITATION.cff")
    assert {"authors", "cff-version", "message", "title"} <= citation.keys()
    assert citation["cff-version"] == "1.2.0" and citation["type"] == "software"
    assert (citation["version"], citation["date-released"]) == RELEASES[0]
    assert citation["license"] == PROJECT["license"]
    (study,) = citation["references"]
    assert {"type", "title", "authors"} <= study.keys()
    assert study["title"].startswith("Deformation Analysis and Prediction of Drop-Stitch")
    assert [a["family-names"] for a in study["authors"]][0::7] == ["Gubbala", "Ogata"]


def test_the_hooks_are_the_checks_of_make_lint():
    (local,) = read_yaml(".pre-commit-config.yaml")["repos"]
    assert local["repo"] == "local"  # nothing is fetched from elsewhere
    lint = (ROOT / "Makefile").read_text(encoding="utf-8").split("\nlint:")[1].split("\n\n")[0]
    programs = re.findall(r"\$\(BIN\)/([\w-]+(?: check| format)?)", lint)
    hooks = [hook["entry"].removeprefix(".venv/bin/") for hook in local["hooks"]]
    assert [h.removesuffix(" --check") for h in hooks] == programs
