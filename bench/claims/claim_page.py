"""Page of measured claims: every figure beside its target, its margin and its command."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from bench.claims.claim_runs import Measurement
from bench.claims.claim_table import Claim
from models.shared.html_page import render_page
from models.shared.page_parts import Figure, Paragraph, Section, Table, TableCell
from models.shared.palette import ALARM, GREEN, INK
from models.shared.svg_drawing import Drawing

_LONGEST: Final = 44
_SHOWN: Final = 2.0
"""Multiple of the target at which a bar ends."""


def write_claims_page(
    measured: Sequence[Measurement], titles: Mapping[str, str], path: Path
) -> Path:
    missed = [m for m in measured if m.met is False]
    judged = [m for m in measured if m.met is not None]
    lead = [
        Paragraph(
            f"{len(judged) - len(missed)} of {len(judged)} targets are met; "
            f"{len(measured) - len(judged)} further figures have no target.",
            "lead",
        )
    ]
    if missed:
        lead.append(Paragraph("Missed: " + ", ".join(m.claim.name for m in missed) + "."))
    groups = dict.fromkeys(m.claim.group for m in measured)
    sections = [
        _section(group, titles[group], [m for m in measured if m.claim.group == group])
        for group in groups
    ]
    path.write_text(render_page("Figures and targets", lead, sections), encoding="utf-8")
    return path


def _section(group: str, title: str, measured: Sequence[Measurement]) -> Section:
    table = Table(
        "", ("figure", "measured", "target", "command"),
        [
            (
                m.claim.what.replace("`", ""),
                TableCell(m.claim.shown(m.figure) if m.figure else m.problem, m.met),
                m.claim.target, m.claim.command,
            )
            for m in measured
        ],
    )  # fmt: skip
    return Section(group, title, [*_margins(title, measured), table])


def target_fraction(claim: Claim, value: float) -> float | None:
    """Part of the target that a value takes up: 1 at the limit, more where it is missed."""
    if claim.at_most is not None:
        return value / claim.at_most if claim.at_most > 0 else None
    if claim.at_least is not None:
        return claim.at_least / value if value > 0 else _SHOWN
    if claim.equal_to is not None and claim.within:
        return abs(value - claim.equal_to) / claim.within
    return None


def _margins(title: str, measured: Sequence[Measurement]) -> list[Figure]:
    """Bars of the part of each target that is taken up; none without such a target."""
    bars = [
        (m, fraction) for m in measured
        if m.figure and (fraction := target_fraction(m.claim, m.figure.value)) is not None
    ]  # fmt: skip
    if not bars:
        return []
    with Drawing(0.7 + 0.28 * len(bars)) as (drawing, ax):
        places = range(len(bars))
        ax.barh(
            places, [min(fraction, _SHOWN) for _, fraction in bars], height=0.6,
            color=[GREEN if m.met else ALARM for m, _ in bars],
        )  # fmt: skip
        ax.axvline(1.0, color=INK, linestyle="--", linewidth=1)
        ax.set_yticks(places, [_shortened(m.claim.what.replace("`", "")) for m, _ in bars])
        ax.set(xlim=(0, _SHOWN), ylim=(len(bars) - 0.4, -0.6), xlabel="value / target")
        ax.grid(False, axis="y")
    alt = f"{title}: part of each target that is taken up; 1 is the target."
    return [Figure("Margins", "Right of the dashed line the target is missed.",
                   [drawing.panel(title, alt)])]  # fmt: skip


def _shortened(text: str) -> str:
    return text if len(text) <= _LONGEST else text[: _LONGEST - 1] + "…"
