"""Heat maps of the residual by phase, stroke, payload, frequency, angle and direction."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

import numpy as np

from firmware_py.display_units import FRACTION, signal_words
from models.gap.report.gap_charts import draw_heat_map, heat_legend, heat_map_height_in
from models.gap.report.gap_json import MappedRegion
from models.plant.identification.noise_floor import Array
from models.shared.drawing import Drawing
from models.shared.pages import Figure
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
        own = [c for c in cells if c.factor == factor]
        if not own:
            continue
        levels = sorted({c.level for c in own}, key=_order)
        place = {c.level: _SHORT.get(c.level, _plain(c.level)) for c in own}
        rows = {s: signal_words(s) for s in signals if s in {c.signal for c in own}}
        curve = _cycle(trial) if factor == "phase" else None
        with Drawing(heat_map_height_in(len(rows), curve=curve is not None)) as (drawing, ax):
            draw_heat_map(
                ax, list(rows.values()), [place[level] for level in levels],
                {(rows[c.signal], place[c.level]): c.size for c in own}, most=most,
                faint={(rows[c.signal], place[c.level]) for c in own
                       if not c.significant},
                curve=curve,
            )  # fmt: skip
        worst = max(own, key=lambda c: float(c.size))
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
    told = [*_SHORT, "negative", "middle", "positive"]
    return float(told.index(level) if level in told else len(told)), level


def _plain(level: str) -> str:
    return level.removesuffix(" Hz").replace(" to ", "–")


def _cycle(trial: Trial) -> Array:
    """First joint over one cycle of the motion, scaled to a largest excursion of 1."""
    start = trial.meta.rest_samples
    joint = trial.joint[start : start + round(trial.meta.period_s / trial.step_s), 0]
    return np.asarray(joint[:: max(1, len(joint) // 80)] / max(float(np.abs(joint).max()), 1e-9))
