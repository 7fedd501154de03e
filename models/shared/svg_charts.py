"""Small pictures as SVG text: heat map, bars, waterfall, traces.

They are drawn `WIDTH` wide, so that on a phone a unit is about a pixel and text stays readable;
pages put two of them side by side where there is room.
"""

from __future__ import annotations

import html
import math
from collections.abc import Collection, Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from models.shared.palette import AFTER, BEFORE, GRID, HEAT, INK, MUTED, PAPER

Array = NDArray[np.float64]

WIDTH: Final = 420
_RAMP: Final = tuple(bytes.fromhex(colour[1:]) for colour in HEAT)
_LETTER: Final = 0.56
"""Mean width of a letter over the size of its font."""


def heat_map(
    rows: Sequence[str],
    columns: Sequence[str],
    cells: Mapping[tuple[str, str], float],
    left: int = 110,
    *,
    width: int = 900,
    most: float | None = None,
    quiet: Collection[tuple[str, str]] = (),
    above: Array | None = None,
) -> str:
    """Table of colours: white at one, dark red at the largest.

    Parameters
    ----------
    rows, columns : sequence of str
        Labels.
    cells : mapping of (row, column) to float
        Values; where one is missing the cell stays empty.
    left, width : int
        Room for the row labels, and in all.
    most : float, optional
        Value that is darkest; by default the largest here.
    quiet : collection of (row, column)
        Cells that are shown without colour.
    above : ndarray, shape (n,), optional
        A curve between -1 and 1 over the whole width of the columns.
    """
    if not cells:
        return "<p>Nothing beyond the noise floor.</p>"
    most = max(most or max(cells.values()), 1.5)
    pitch, height, font = (width - left) / len(columns), 26, 11
    longest = max(map(len, columns)) * font * _LETTER
    turned = longest > pitch - 4
    if turned:  # the last label leans out to the right
        pitch = (width - left - 0.5 * longest) / len(columns)
    whole = all(float(v).is_integer() for v in cells.values())
    curve = 0 if above is None else 34
    top = curve + (round(longest * 0.87) + 12 if turned else 20)
    parts = [] if above is None else [_curve(above, left, width, curve)]
    for c, column in enumerate(columns):
        x = left + (c + 0.5) * pitch
        place = (
            f'transform="translate({x + 4:.1f},{top - 6}) rotate(-60)"'
            if turned
            else f'x="{x:.1f}" y="{top - 6}" text-anchor="middle"'
        )
        parts.append(_text(column, place, font, MUTED if not turned else INK))
    for r, row in enumerate(rows):
        y = top + r * height
        parts.append(_text(row, f'x="{left - 8}" y="{y + 17}" text-anchor="end"', 12))
        for c, column in enumerate(columns):
            value = cells.get((row, column))
            if value is None:
                continue
            share = 0.0 if (row, column) in quiet else _share(value, most)
            x = left + c * pitch
            ink = MUTED if (row, column) in quiet else PAPER if share > 0.6 else INK
            parts += [
                f'<rect x="{x:.1f}" y="{y}" width="{pitch - 1.5:.1f}" height="{height - 1.5}" '
                f'rx="2" fill="{_colour(share)}"><title>{html.escape(f"{row}, {column}")}: '
                f"{value:.2g}</title></rect>",
                _text(
                    f"{value:.0f}" if whole or value >= 9.95 else f"{value:.1f}",
                    f'x="{x + 0.5 * pitch:.1f}" y="{y + 17}" text-anchor="middle"', 11, ink,
                ),
            ]  # fmt: skip
    return _svg(parts, top + len(rows) * height + 2, width)


def bars(rows: Sequence[tuple[str, float]], unit: str, line: float, said: str) -> str:
    """Horizontal bars with their values, the first one marked, and a line at some value."""
    left, right, height = 150, 60, 24
    most = max([*(v for _, v in rows), 1.1 * line])
    scale = (WIDTH - left - right) / most
    parts = []
    for k, (label, value) in enumerate(rows):
        y = k * height
        size = max(scale * value, 1.0)
        parts += [
            _text(label, f'x="{left - 8}" y="{y + 16}" text-anchor="end"', 12),
            f'<rect x="{left}" y="{y + 3}" width="{size:.1f}" height="{height - 7}" rx="2" '
            f'fill="{MUTED if k else BEFORE}"/>',
            _text(f"{value:.1f}{unit}", f'x="{left + size + 5:.1f}" y="{y + 16}"', 12),
        ]
    return _svg([*parts, *_line(left + scale * line, height * len(rows), said)],
                height * len(rows) + 18)  # fmt: skip


def waterfall(steps: Sequence[tuple[str, float]]) -> str:
    """What every step leaves (solid) and takes away (pale), over a line at one."""
    left, right, height = 150, 50, 34
    scale = (WIDTH - left - right) / max([*(v for _, v in steps), 1.1])
    parts, before = [], steps[0][1]
    for k, (label, value) in enumerate(steps):
        y = k * height
        kept, lost = scale * min(value, before), scale * max(before - value, 0.0)
        colour = BEFORE if k == 0 else MUTED if k == len(steps) - 1 else AFTER
        parts += [
            _text(label, f'x="{left - 8}" y="{y + 21}" text-anchor="end"', 12),
            f'<rect x="{left + kept:.1f}" y="{y + 5}" width="{lost:.1f}" height="{height - 10}" '
            f'fill="{AFTER}" fill-opacity=".18"/>',
            f'<rect x="{left}" y="{y + 5}" width="{max(scale * value, 1):.1f}" '
            f'height="{height - 10}" fill="{colour}"/>',
            _text(
                f"{value:.2f}", f'x="{left + scale * max(value, before) + 6:.1f}" y="{y + 21}"', 12
            ),
        ]
        before = value
    return _svg([*parts, *_line(left + scale, height * len(steps), "noise floor")],
                height * len(steps) + 20)  # fmt: skip


def traces(
    time_s: Array, series: Sequence[tuple[str, Array]], unit: str, floor: float | None = None
) -> str:
    """Lines over time around zero, thinned to what a screen shows, on a band of ± `floor`."""
    left, top, height, bottom = 44, 6, 130, 22
    seen = [float(np.nanmax(np.abs(v))) for _, v in series]
    most = max([*seen, 1e-12])
    every = max(1, len(time_s) // 400)
    spread = max(float(time_s[-1] - time_s[0]), 1e-9)
    x = left + (WIDTH - left - 4) * (time_s - time_s[0]) / spread
    half = height / 2
    middle = top + half
    parts = []
    if floor is not None and floor < most:
        band = half * floor / most
        parts.append(
            f'<rect x="{left}" y="{middle - band:.1f}" width="{WIDTH - left - 4}" '
            f'height="{2 * band:.1f}" fill="{MUTED}" fill-opacity=".2"/>'
        )
    parts.append(
        f'<line x1="{left}" x2="{WIDTH - 4}" y1="{middle}" y2="{middle}" stroke="{GRID}"/>'
    )
    for place, value in ((top + 8, most), (middle + 4, 0.0), (top + height, -most)):
        parts.append(
            _text(f"{value:.2g}", f'x="{left - 6}" y="{place:.1f}" text-anchor="end"', 11, MUTED)
        )
    parts.append(_text(unit, f'x="{left - 6}" y="{middle + 22}" text-anchor="end"', 11, MUTED))
    for second in range(0, math.floor(spread) + 1, max(1, round(spread / 5))):
        at = left + (WIDTH - left - 4) * second / spread
        label = f"{second} s" if second == 0 else f"{second}"
        parts.append(
            _text(label, f'x="{at:.1f}" y="{top + height + 16}" text-anchor="middle"', 11, MUTED)
        )
    for k, (_, values) in enumerate(series):
        y = middle - half * values / most
        parts.append(_polyline(x[::every], y[::every], (BEFORE, AFTER)[k % 2]))
    return _svg(parts, top + height + bottom)


def legend(entries: Sequence[tuple[str, str]]) -> str:
    """Colours and what they stand for, as a list of the page's style."""
    rows = "".join(
        f'<li><svg viewBox="0 0 24 6" aria-hidden="true"><line x1="1" x2="23" y1="3" y2="3" '
        f'stroke="{colour}" stroke-width="2.4"/></svg>{html.escape(label)}</li>'
        for colour, label in entries
    )
    return f'<ul class="legend">{rows}</ul>'


def scale_of(most: float) -> str:
    """Key of the heat map's colours."""
    parts, pieces = [], 40
    for k in range(pieces):
        parts.append(
            f'<rect x="{110 + 5 * k}" y="2" width="5.2" height="12" '
            f'fill="{_colour(k / (pieces - 1))}"/>'
        )
    parts += [
        _text("1, noise", 'x="104" y="12" text-anchor="end"', 11, MUTED),
        _text(f"{most:.1f} noise floors", f'x="{116 + 5 * pieces}" y="12"', 11, MUTED),
    ]
    return _svg(parts, 16)


def _share(value: float, most: float) -> float:
    return min(math.log(max(value, 1.0)) / math.log(most), 1.0)


def _colour(share: float) -> str:
    place = share * (len(_RAMP) - 1)
    k = min(int(place), len(_RAMP) - 2)
    mixed = [round(a + (place - k) * (b - a)) for a, b in zip(_RAMP[k], _RAMP[k + 1], strict=True)]
    return "#" + "".join(f"{value:02x}" for value in mixed)


def _curve(values: Array, left: int, width: int, height: int) -> str:
    x = left + (width - left) * np.arange(len(values)) / (len(values) - 1)
    y = height / 2 - (height / 2 - 4) * values
    zero = f'<line x1="{left}" x2="{width}" y1="{height / 2}" y2="{height / 2}" stroke="{GRID}"/>'
    return zero + _polyline(x, y, MUTED)


def _line(x: float, height: float, said: str) -> list[str]:
    return [
        f'<line x1="{x:.1f}" x2="{x:.1f}" y1="0" y2="{height}" stroke="{INK}" '
        f'stroke-dasharray="3 3"/>',
        _text(said, f'x="{x:.1f}" y="{height + 14}" text-anchor="middle"', 11, MUTED),
    ]


def _polyline(x: Array, y: Array, colour: str) -> str:
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True) if b == b)
    return f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.4"/>'


def _text(said: str, place: str, size: int, colour: str = INK) -> str:
    return f'<text {place} font-size="{size}" fill="{colour}">{html.escape(said)}</text>'


def _svg(parts: Sequence[str], height: float, width: int = WIDTH) -> str:
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height:.0f}" '
        f'width="{width}">{"".join(parts)}</svg>'
    )
