"""Reliability of the probabilities with which effects are said to be missing.

Effects that were said to be missing with a probability in one bin are counted, and how many of them
were hidden in the rig. Where the probabilities are right, the fraction is the mean probability of
the bin. Effects below the first edge are left out: the catalogue has many more of them than of all
others.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np
from matplotlib import pyplot

from bench.gap.scores.fraction_interval import fraction_with_interval
from models.shared.palette import BLUE, MUTED, ORANGE
from models.shared.svg_drawing import FILE_STYLE

EDGES: Final = (0.05, 0.2, 0.4, 0.6, 0.8, 0.9, 0.97, 1.0)
"""Of the bins. Each holds its lower edge; the last one also what rounding puts above 1."""

COLOURS: Final = {"tuning": BLUE, "test": ORANGE}
"""Of the rigs of each purpose."""
WORDS: Final = {"tuning": "rigs for tuning", "test": "rigs for testing"}

CAPTION: Final = (
    "Each point: effects that were said to be missing with a probability in one bin, and the\n"
    "fraction of them that was hidden in the rig. A denied effect that nothing tells from its\n"
    "stand-in does not count. Bars: 95 % intervals (Clopper–Pearson). Numbers: effects. Dashed:\n"
    "where the probabilities are right; below it they are too high, above it too low."
)

LEAST_COUNT: Final = 20
"""Effects of a bin from which its fraction is held against its probability."""

Bins = Sequence[Mapping[str, Any]]


def reliability_bins(said: Iterable[tuple[float, bool]]) -> list[dict[str, Any]]:
    """Bins of probabilities, each with its edges, count, mean probability and fraction right.

    `said`: probability of an effect that it is missing, and whether it was.
    """
    members: list[list[tuple[float, bool]]] = [[] for _ in EDGES[1:]]
    for probability, missing in said:
        if probability >= EDGES[0]:
            members[int(np.searchsorted(EDGES[1:-1], probability, "right"))].append(
                (probability, missing)
            )
    return [
        {
            "from": low, "to": high,
            "mean_probability": float(np.mean([p for p, _ in rows])) if rows else None,
            **fraction_with_interval([missing for _, missing in rows]),
        }
        for low, high, rows in zip(EDGES[:-1], EDGES[1:], members, strict=True)
    ]  # fmt: skip


def largest_deviation(bins: Bins) -> float | None:
    """Largest difference of probability and fraction right, over the bins of enough effects."""
    off = [abs(b["mean_probability"] - b["fraction"]) for b in bins if b["of"] >= LEAST_COUNT]
    return max(off, default=None)


def reliability_table(bins: Mapping[str, Bins]) -> str:
    """Markdown table: one row for each bin, one column for each rig; empty without any effect."""
    if not any(b["of"] for own in bins.values() for b in own):
        return ""
    head = "| missing, of those said to be with a probability of | "
    lines = [head + " | ".join(bins) + " |", "|---" * (len(bins) + 1) + "|"]
    for row in zip(*bins.values(), strict=True):
        cells = [f"{round(b['fraction'] * b['of'])} of {b['of']}" if b["of"] else "–" for b in row]
        lines.append(f"| {row[0]['from']:g} to {row[0]['to']:g} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def reliability_svg(bins: Mapping[str, Bins]) -> str:
    """Reliability diagram as an SVG: fraction right over probability, with the diagonal."""
    text = io.StringIO()
    with pyplot.rc_context(FILE_STYLE):
        figure, ax = pyplot.subplots(figsize=(7.0, 5.2), layout="constrained")
        ax.plot([0, 1], [0, 1], "--", color=MUTED, lw=1.1)
        for purpose, own in bins.items():
            if filled := [b for b in own if b["of"]]:
                _draw_points(ax, filled, purpose)
        ax.set(xlim=(0, 1.04), ylim=(-0.03, 1.05))
        ax.set(xlabel="probability of being missing", ylabel="fraction that was missing")
        if any(b["of"] for own in bins.values() for b in own):
            ax.legend(loc="upper left", frameon=False)
        figure.supxlabel(CAPTION, x=0.02, ha="left", fontsize=8)
        figure.savefig(text, format="svg", metadata={"Date": None})
        pyplot.close(figure)
    return text.getvalue()


def _draw_points(ax: Any, bins: Bins, purpose: str) -> None:
    """Points of the rigs of one purpose, with their intervals and counts."""
    x = [b["mean_probability"] for b in bins]
    y = np.array([b["fraction"] for b in bins])
    low, high = np.array([b["interval"] for b in bins]).T
    ax.errorbar(
        x, y, [y - low, high - y], fmt="o", ms=4, lw=1.1, capsize=2.5, color=COLOURS[purpose],
        label=WORDS[purpose], clip_on=False,
    )  # fmt: skip
    side = 1 if purpose == "test" else -1  # numbers of both purposes do not meet
    for b, place, fraction in zip(bins, x, y, strict=True):
        ax.annotate(
            f"{b['of']}", (place, fraction), (5 * side, 3), textcoords="offset points",
            ha="left" if side > 0 else "right", fontsize=8, color=COLOURS[purpose],
        )  # fmt: skip
