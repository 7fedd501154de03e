"""Tables of the documentation that are drawn from the accepted figures.

A table stands between `<!-- claims: GROUP -->` and `<!-- /claims -->`. The group `headline` holds
the claims of all groups that are marked so.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Final

from bench.claims.claim_table import ROOT, Claim, ClaimFigure, read_accepted, read_claims

HEADLINE: Final = "headline"
_MARKED: Final = re.compile(r"(<!-- claims: ([\w-]+) -->\n)(.*?)(<!-- /claims -->)", re.DOTALL)


def figure_table(claims: Iterable[Claim], accepted: Mapping[str, ClaimFigure]) -> str:
    """Markdown table of one group."""
    lines = ["| figure | measured | target | on |", "|---|---|---|---|"]
    for claim in claims:
        figure = accepted.get(claim.name)
        if figure is None:
            lines.append(f"| {claim.what} | not measured | {claim.target} | |")
            continue
        missed = ", **missed**" if claim.is_met(figure.value) is False else ""
        note = f", {figure.note}" if figure.note else ""
        lines.append(
            f"| {claim.what} | {claim.shown(figure)} | {claim.target}{missed} | {figure.on}{note} |"
        )
    return "\n".join(lines) + "\n"


def redraw_tables(text: str, claims: Sequence[Claim], accepted: Mapping[str, ClaimFigure]) -> str:
    """A document with the tables between its marks drawn anew."""

    def drawn(match: re.Match[str]) -> str:
        group = [c for c in claims if (c.headline if match[2] == HEADLINE else c.group == match[2])]
        return match[1] + figure_table(group, accepted) + match[4]

    return _MARKED.sub(drawn, text)


def marked_groups(text: str) -> list[str]:
    """Groups whose tables a document holds."""
    return [match[2] for match in _MARKED.finditer(text)]


def documents(root: Path = ROOT) -> list[Path]:
    """Files that may hold tables of figures."""
    return [root / "README.md", *sorted((root / "docs").rglob("*.md"))]


def redraw_documents(root: Path = ROOT) -> list[Path]:
    """Redraw every document; returns those that changed."""
    claims, accepted, changed = read_claims(), read_accepted(), []
    for path in documents(root):
        before = path.read_text(encoding="utf-8")
        after = redraw_tables(before, claims, accepted)
        if after != before:
            path.write_text(after, encoding="utf-8")
            changed.append(path)
    return changed
