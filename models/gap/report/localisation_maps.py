"""Maps of where the gap is: a table for each way to divide the residual, shaded by its size."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Final

from firmware_py.core.units import FRACTION, signal_words
from models.gap.report.gap_json import MappedRegion
from models.shared.pages import Cell, Paragraph, Part, Table, TableCell

FACTORS: Final = {
    "phase": "Phase of the cycle", "stroke": "Stroke", "payload": "Payload",
    "band": "Frequency in Hz", "angle": "Angle", "direction": "Direction",
}  # fmt: skip
_SHORT: Final = {
    "way out to positive angles": "out to +", "return from positive angles": "back from +",
    "way out to negative angles": "out to −", "return from negative angles": "back from −",
    "towards +": "to +", "towards −": "to −",
}  # fmt: skip


def localisation_maps(cells: Sequence[MappedRegion], false_discovery_rate: float) -> list[Part]:
    """One table for each factor, all on one scale."""
    largest = max([c.size for c in cells if c.factor in FACTORS] + [1.5])
    note = (
        "RMS of the residual after the nominal parameters were refitted, in noise floors. Only "
        "shaded values are significant, at a false-discovery rate of "
        f"{FRACTION.text(false_discovery_rate)}."
    )
    maps: list[Part] = [
        _map(title, regions, largest)
        for factor, title in FACTORS.items()
        if (regions := [c for c in cells if c.factor == factor])
    ]
    return [Paragraph(note, "note"), *maps]


def _map(title: str, regions: Sequence[MappedRegion], largest: float) -> Table:
    levels = sorted({c.level for c in regions}, key=_order)
    by_place = {(c.signal, c.level): c for c in regions}
    rows: list[list[Cell]] = [
        [signal_words(signal), *(_cell(by_place.get((signal, level)), largest) for level in levels)]
        for signal in sorted({c.signal for c in regions})
    ]
    return Table(title, ["", *(_SHORT.get(level, _plain(level)) for level in levels)], rows)


def _cell(region: MappedRegion | None, largest: float) -> TableCell:
    """Size of a region, shaded by its logarithm from the noise to the largest."""
    if region is None:
        return TableCell("")
    text = f"{region.size:.0f}" if region.size >= 9.95 else f"{region.size:.1f}"
    if not region.significant:
        return TableCell(text)
    return TableCell(text, shade=math.log(max(region.size, 1.0)) / math.log(largest))


def _order(level: str) -> tuple[float, str]:
    """Sort key of a level: numeric levels by value, others in a fixed order."""
    number = re.match(r"[\d.]+", level)
    if number:
        return float(number[0]), level
    order = [*_SHORT, "negative", "middle", "positive"]
    return float(order.index(level) if level in order else len(order)), level


def _plain(level: str) -> str:
    return level.removesuffix(" Hz").replace(" to ", "–")
