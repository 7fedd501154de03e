"""Heat maps of the residual by phase, stroke, payload, frequency, angle and direction."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.colors import LogNorm

from firmware_py.core.units import FRACTION, signal_words
from models.gap.report.gap_json import MappedRegion
from models.plant.identification.noise_floor import Array
from models.shared.drawing import Drawing
from models.shared.pages import Figure, LegendEntry
from models.shared.palette import INK, MUTED, PAPER, heat_colours
from models.trials.trial import Trial

FACTORS: Final = {
    "phase": "Phase of the cycle", "stroke": "Stroke", "payload": "Payload",
    "band": "Frequency, Hz", "angle": "Angle", "direction": "Direction",
}  # fmt: skip
_SHORT: Final = {
    "way out to positive angles": "out to +", "return from positive angles": "back from +",
    "way out to negative angles": "out to −", "return from negative angles": "back from −",
    "towards +": "to +", "towards −": "to −",
}  # fmt: skip


def localisation_maps(
    cells: Sequence[MappedRegion], trial: Trial, false_discovery_rate: float
) -> Figure:
    """Heat map for each way to divide the residual, all on one colour scale."""
    most = max([c.size for c in cells if c.factor in FACTORS] + [1.5])
    signals = sorted({c.signal for c in cells})
    panels = []
    for factor, title in FACTORS.items():
        regions = [c for c in cells if c.factor == factor]
        if not regions:
            continue
        levels = sorted({c.level for c in regions}, key=_order)
        place = {c.level: _SHORT.get(c.level, _plain(c.level)) for c in regions}
        rows = {s: signal_words(s) for s in signals if s in {c.signal for c in regions}}
        curve = _cycle(trial) if factor == "phase" else None
        height_in = 0.6 + 0.26 * len(rows) + (0.3 if curve is not None else 0.0)
        with Drawing(height_in) as (drawing, ax):
            draw_heat_map(
                ax, list(rows.values()), [place[level] for level in levels],
                {(rows[c.signal], place[c.level]): c.size for c in regions}, most=most,
                faint={(rows[c.signal], place[c.level]) for c in regions
                       if not c.significant},
                curve=curve,
            )  # fmt: skip
        worst = max(regions, key=lambda c: float(c.size))
        panels.append(
            drawing.panel(
                title,
                f"Residual of {len(rows)} signals by {title.lower()}, in noise floors; the largest "
                f"is {worst.size:.1f} for {signal_words(worst.signal)} at {worst.level}.",
            )
        )
    return Figure(
        "", "RMS of the residual after the nominal parameters were refitted, in noise floors. "
        f"Grey numbers are not significant at a false-discovery rate of "
        f"{FRACTION.text(false_discovery_rate)}.",
        panels, legend=heat_legend(most),
    )  # fmt: skip


def _order(level: str) -> tuple[float, str]:
    """Sort key of a level: numeric levels by value, others in a fixed order."""
    number = re.match(r"[\d.]+", level)
    if number:
        return float(number[0]), level
    order = [*_SHORT, "negative", "middle", "positive"]
    return float(order.index(level) if level in order else len(order)), level


def _plain(level: str) -> str:
    return level.removesuffix(" Hz").replace(" to ", "–")


def _cycle(trial: Trial) -> Array:
    """First joint over one cycle of the motion, scaled to a largest excursion of 1."""
    start = trial.meta.rest_samples
    joint = trial.joint[start : start + round(trial.meta.period_s / trial.step_s), 0]
    return np.asarray(joint[:: max(1, len(joint) // 80)] / max(float(np.abs(joint).max()), 1e-9))


def draw_heat_map(
    ax: Any,
    rows: Sequence[str],
    columns: Sequence[str],
    cells: Mapping[tuple[str, str], float],
    *,
    most: float,
    faint: Collection[tuple[str, str]] = (),
    curve: Array | None = None,
) -> None:
    """Draw a table of values on a logarithmic colour scale from 1, white, to `most`, dark red.

    `curve` (n,), between -1 and 1, is drawn above the columns over their whole width.
    """
    scale = LogNorm(1.0, max(most, 1.5), clip=True)
    colours, whole = heat_colours(), all(float(v).is_integer() for v in cells.values())
    for (row, column), value in cells.items():
        x, y = columns.index(column), rows.index(row)
        fraction = 0.0 if (row, column) in faint else float(scale(value))
        ax.fill_between([x - 0.47, x + 0.47], y - 0.45, y + 0.45, color=colours(fraction), lw=0)
        ink = MUTED if (row, column) in faint else PAPER if fraction > 0.6 else INK
        text = f"{value:.0f}" if whole or value >= 9.95 else f"{value:.1f}"
        ax.text(x, y, text, color=ink, ha="center", va="center", fontsize=8.5)
    top = -0.5
    if curve is not None:
        top = -1.7
        place = np.linspace(-0.5, len(columns) - 0.5, len(curve))
        ax.plot(place, -1.1 - 0.5 * curve, color=MUTED, lw=1.2)
    ax.set(xlim=(-0.5, len(columns) - 0.5), ylim=(len(rows) - 0.5, top))
    ax.set_yticks(range(len(rows)), rows)
    turned = sum(map(len, columns)) > 44  # letters of 8.5 pt that fit side by side
    ax.set_xticks(
        range(len(columns)), columns,
        **({"rotation": 40, "ha": "right", "rotation_mode": "anchor"} if turned else {}),
    )  # fmt: skip
    ax.tick_params(length=0)
    ax.grid(False)
    ax.spines[:].set_visible(False)


def heat_legend(most: float) -> list[LegendEntry]:
    """Legend of the colours of `draw_heat_map`: noise, the largest value and two in between."""
    colours = heat_colours()
    values = np.geomspace(1.0, max(most, 1.5), 4)
    labels = ["1 (noise)", *(f"{v:.2g}" for v in values[1:-1]), f"{values[-1]:.2g} noise floors"]
    return [
        LegendEntry(_hex(colours(fraction)), label)
        for fraction, label in zip((0.12, 1 / 3, 2 / 3, 1.0), labels, strict=True)
    ]


def _hex(colour: tuple[float, float, float, float]) -> str:
    return "#" + "".join(f"{round(255 * v):02x}" for v in colour[:3])
