"""Small pictures as SVG text: heat map, bars, traces."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence

import numpy as np

from models.gap.spectrum import Array

WIDTH = 900


def heat_map(
    rows: Sequence[str],
    columns: Sequence[str],
    cells: Mapping[tuple[str, str], float],
    left: int = 110,
) -> str:
    """Table of colours: white at one noise floor, dark red at the largest."""
    if not cells:
        return "<p>Nothing beyond the noise floor.</p>"
    top, height = 150, 26
    width = (WIDTH - left) / max(len(columns), 1)
    most = max(max(cells.values()), 1.5)
    parts = []
    for c, column in enumerate(columns):
        x = left + (c + 0.6) * width
        parts.append(
            f'<text transform="translate({x:.1f},{top - 6}) rotate(-60)" font-size="11">'
            f"{html.escape(column)}</text>"
        )
    for r, row in enumerate(rows):
        y = top + r * height
        parts.append(f'<text x="0" y="{y + 17}" font-size="12">{html.escape(row)}</text>')
        for c, column in enumerate(columns):
            size = cells.get((row, column))
            if size is None:
                continue
            share = math.log(max(size, 1.0)) / math.log(most)
            colour = (
                f"rgb({255 - int(75 * share)},{255 - int(235 * share)},{255 - int(235 * share)})"
            )
            parts.append(
                f'<rect x="{left + c * width:.1f}" y="{y}" width="{width - 1:.1f}" '
                f'height="{height - 1}" fill="{colour}"><title>{html.escape(row)}, '
                f"{html.escape(column)}: {size:.1f}</title></rect>"
            )
            ink = "#fff" if share > 0.6 else "#333"
            parts.append(
                f'<text x="{left + (c + 0.5) * width:.1f}" y="{y + 17}" font-size="10" '
                f'fill="{ink}" text-anchor="middle">{size:.1f}</text>'
            )
    return _svg(parts, top + len(rows) * height + 4)


def bars(rows: Sequence[tuple[str, float]], unit: str) -> str:
    """Horizontal bars with their values."""
    left, height = 300, 24
    most = max((v for _, v in rows), default=1.0) or 1.0
    parts = []
    for k, (label, value) in enumerate(rows):
        y = k * height
        size = max((WIDTH - left - 120) * value / most, 1.0)
        parts += [
            f'<text x="{left - 8}" y="{y + 16}" font-size="12" text-anchor="end">'
            f"{html.escape(label)}</text>",
            f'<rect x="{left}" y="{y + 3}" width="{size:.1f}" height="{height - 7}" '
            f'fill="{"#4878a8" if k else "#b04030"}"/>',
            f'<text x="{left + size + 6:.1f}" y="{y + 16}" font-size="12">'
            f"{value:.2f} {unit}</text>",
        ]
    return _svg(parts, height * len(rows) + 6)


def traces(title: str, time_s: Array, series: Sequence[tuple[str, Array]]) -> str:
    """Lines over time, thinned to what a screen shows."""
    left, height = 110, 110
    most = max(float(np.nanmax(np.abs(v))) for _, v in series) or 1.0
    every = max(1, len(time_s) // 400)
    x = left + (WIDTH - left - 90) * (time_s - time_s[0]) / max(time_s[-1] - time_s[0], 1e-9)
    parts = [
        f'<text x="0" y="{height / 2}" font-size="12">{html.escape(title)}</text>',
        f'<text x="0" y="{height / 2 + 16}" font-size="11" fill="#666">±{most:.2g}</text>',
        f'<line x1="{left}" x2="{WIDTH - 90}" y1="{height / 2}" y2="{height / 2}" stroke="#ccc"/>',
    ]
    for k, (label, values) in enumerate(series):
        colour = ("#b04030", "#4878a8")[k % 2]
        y = height / 2 - (height / 2 - 4) * values / most
        points = " ".join(
            f"{a:.1f},{b:.1f}" for a, b in zip(x[::every], y[::every], strict=True) if b == b
        )
        parts += [
            f'<polyline points="{points}" fill="none" stroke="{colour}"/>',
            f'<text x="{WIDTH - 80}" y="{30 + 18 * k}" font-size="12" fill="{colour}">'
            f"{label}</text>",
        ]
    return _svg(parts, height)


def _svg(parts: Sequence[str], height: float) -> str:
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height:.0f}" '
        f'width="{WIDTH}">{"".join(parts)}</svg>'
    )
