"""Page of a campaign: figures of its results over each axis, conditions, failures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from firmware_py.core.signals import unit_of
from firmware_py.core.units import (
    PRESSURE,
    DisplayUnit,
    error_unit,
    signal_unit,
    signal_words,
)
from hil.campaign.cases import flat
from hil.campaign.kinds.case_kind import CaseKind
from hil.campaign.specification import CampaignSpec, Draw
from hil.campaign.summary import CampaignDocument, SummaryRow
from models.shared.drawing import Drawing
from models.shared.pages import (
    NO_VALUE,
    Cell,
    Facts,
    Figure,
    Notice,
    Panel,
    Paragraph,
    Part,
    Section,
    Table,
    TableCell,
    render_page,
)
from models.shared.palette import BLUE

MOST_POINTS: Final = 3000
"""Largest number of points in a drawing. More make the page slow, so they are thinned evenly
[assumed]."""
MOST_LEVELS: Final = 12
"""Largest number of an axis's values for a table with a row each; more are drawn as points."""
NO_BREAK: Final = "\u00a0"
SOURCES: Final = {
    "sil": "simulated runs of the robot's loop", "fmu": "simulated runs of an FMU",
    "gap": "diagnoses of simulated trials", "rig": "simulated trials of the rig",
}  # fmt: skip
SIMULATED: Final = Notice(
    "simulated", "Simulated", "Every case is a computation. No robot was run."
)
UNKNOWN: Final = Notice(
    "unknown", "Origin not stated",
    "A kind of cases of one's own: do not take its figures for measurements.",
)  # fmt: skip


class Quantity(NamedTuple):
    """Number of the results that the page shows."""

    name: str  # Dotted name in the result
    words: str

    @property
    def unit(self) -> DisplayUnit:
        last = self.name.rpartition(".")[2]
        if last == "di":
            return signal_unit(last)
        if last.endswith(("_fraction", "coverage", "coverage_least", "right")):
            return error_unit("1")
        if last.endswith("ticks"):
            return DisplayUnit("", 1.0, 0)
        if (unit := unit_of(last)) in ("m", "rad"):
            return error_unit(unit)
        return DisplayUnit(signal_unit(last).name, signal_unit(last).factor, 2)

    @property
    def label(self) -> str:
        return self.unit.label(self.words)

    def of(self, row: SummaryRow) -> float:
        """Value in a row; NaN if it has none."""
        value = row.result.get(self.name)
        number = isinstance(value, int | float) and not isinstance(value, bool)
        return float(value) if number and math.isfinite(value) else math.nan  # type: ignore[arg-type]

    def quantiles(self, rows: Sequence[SummaryRow], levels: Sequence[float]) -> list[str]:
        values = [v for row in rows if not math.isnan(v := self.of(row))]
        return [self.unit.number(v) for v in np.quantile(values, levels)] if values else []


def write_campaign_page(
    document: CampaignDocument, spec: CampaignSpec, kind: CaseKind[Any],
    rows: Sequence[SummaryRow], path: Path,
) -> None:  # fmt: skip
    quantities = [Quantity(*item) for item in kind.figures.items()]
    quantities = [q for q in quantities if not all(math.isnan(q.of(row)) for row in rows)]
    source = SOURCES.get(kind.name, f"cases of the kind {kind.name}")
    done = document.states.get("done", 0)
    lead: list[Part] = [
        SIMULATED if kind.name in SOURCES else UNKNOWN,
        Paragraph(f"{done} of {document.cases} {source} have a result.", "lead"),
    ]
    # An axis of one value is a condition common to all cases.
    varied = [name for name in spec.axes if name in spec.draw or len(spec.grid[name]) > 1]
    sections = [
        Section("figures", "Figures of all cases", [_overall(quantities, rows)]),
        *(_axis_section(name, spec.draw.get(name), quantities, rows) for name in varied),
        Section("conditions", "Conditions", [_conditions(spec, kind.name, document.code)]),
        Section("failures", "Cases without a result", [_failures(document)]),
    ]
    title = f"Campaign: {spec.name}" if spec.name else f"Campaign of {kind.name}"
    path.write_text(render_page(title, lead, sections, datetime.now(UTC)), encoding="utf-8")


def _overall(quantities: Sequence[Quantity], rows: Sequence[SummaryRow]) -> Part:
    if not quantities:
        return Paragraph("No case has a result yet.", "missing")
    table: list[list[Cell]] = [
        [q.label, *q.quantiles(rows, [0.0, 0.5, 0.9, 1.0]),
         str(sum(not math.isnan(q.of(row)) for row in rows))]
        for q in quantities
    ]  # fmt: skip
    return Table("", ["", "smallest", "median", "90 %", "largest", "cases"], table)


def _axis_section(
    axis: str, draw: Draw | None, quantities: Sequence[Quantity], rows: Sequence[SummaryRow]
) -> Section:
    # "payload" for "payload_kg", "faults: lost" for "faults.lost"
    words = ": ".join(signal_words(part) for part in axis.split("."))
    values, form = [_value_of(row, axis) for row in rows], draw.form if draw else ""
    levels = list(dict.fromkeys(values))
    part: Part
    if not quantities:
        part = Paragraph("No case has a result yet.", "missing")
    elif len(levels) <= MOST_LEVELS and not form.endswith("uniform"):
        table: list[list[Cell]] = []
        for level in levels:
            at_level = [row for row, value in zip(rows, values, strict=True) if value == level]
            cells: list[Cell] = [_level_text(level, _axis_unit(axis))]
            cells += [" / ".join(q.quantiles(at_level, [0.5, 0.9])) or NO_VALUE for q in quantities]
            done = sum(row.state == "done" for row in at_level)
            met = None if done == len(at_level) else False
            table.append([*cells, TableCell(f"{done} of {len(at_level)}", met)])
        header = [_axis_unit(axis).label(words), *(q.label for q in quantities), "with result"]
        part = Table("", header, table, "Median and 90th percentile over the cases of each row.")
    elif all(isinstance(v, int | float) for v in values) and not words.endswith("seed"):
        panels = [_points(axis, words, q, values, rows, form) for q in quantities]
        part = Figure("", "One point a case.", panels)
    else:
        part = Paragraph(f"{len(levels)} values, each case of its own: see summary.csv.")
    return Section(f"axis-{axis.replace('.', '-')}", f"By {words}", [part])


def _value_of(row: SummaryRow, axis: str) -> Any:
    """Value of an axis; a table, such as effects, as text."""
    if axis in row.config:
        return row.config[axis]
    prefix = f"{axis}."
    inside = {n.removeprefix(prefix): v for n, v in row.config.items() if n.startswith(prefix)}
    return ", ".join(
        f"{n} {v:g}" if isinstance(v, float) else f"{n} {v}" for n, v in inside.items()
    )


def _points(
    axis: str, words: str, quantity: Quantity, values: Sequence[Any], rows: Sequence[SummaryRow],
    form: str,
) -> Panel:  # fmt: skip
    x, y = np.array(values, dtype=float), np.array([quantity.of(row) for row in rows])
    x, y = x[np.isfinite(y)], y[np.isfinite(y)]
    unit, step = _axis_unit(axis), max(len(y) // MOST_POINTS, 1)
    with Drawing() as (drawing, ax):
        shown_x, shown_y = unit.shown(x[::step]), quantity.unit.shown(y[::step])
        ax.plot(shown_x, shown_y, ".", color=BLUE, ms=3, alpha=0.6)
        if form == "log_uniform":
            ax.set_xscale("log")
        ax.set(xlabel=unit.label(words), ylabel=quantity.label)
    middle, most = quantity.unit.text(np.median(y)), quantity.unit.text(y.max())
    alt = f"{quantity.words} over {words}: median {middle}, largest {most}."
    return drawing.panel(quantity.words, alt)


def _conditions(spec: CampaignSpec, kind: str, code: str) -> Part:
    """Conditions in the campaign's file: fixed values, axes of the grid, and draws."""
    rows = [("kind", kind), ("code", code)]
    rows += [(name, _in_words(name, value)) for name, value in flat(spec.fixed).items()]
    for name, values in spec.grid.items():
        more = f", {len(values)} in all" if len(values) > MOST_LEVELS else ""
        rows.append((name, _in_words(name, values[:MOST_LEVELS]) + more))
    for name, (form, limits) in spec.draw.items():
        joined = (", " if form == "choice" else " to ").join(_in_words(name, v) for v in limits)
        rows.append((name, f"{joined}, {form.replace('_', '-')}"))
    if spec.draws is not None:
        rows.append(("draws", f"{spec.draws} with seed {spec.draw_seed}"))
    return Facts(rows)


def _in_words(name: str, value: Any) -> str:
    """Text of a value in its display unit; of a table, its names and values."""
    if isinstance(value, dict):
        return ", ".join(f"{n} {_in_words('', v)}" for n, v in flat(value).items()) or "none"
    if isinstance(value, list):
        return ", ".join(_in_words(name, v) for v in value)
    unit = _axis_unit(name)
    return f"{_level_text(value, unit)}{NO_BREAK}{unit.name}".removesuffix(NO_BREAK)


def _axis_unit(axis: str) -> DisplayUnit:
    last = axis.rpartition(".")[2]
    if unit_of(last) == "Pa":
        return PRESSURE
    return signal_unit(last) if unit_of(last) else DisplayUnit("", 1.0, 2)


def _level_text(level: Any, unit: DisplayUnit) -> str:
    if isinstance(level, bool):
        return "yes" if level else "no"
    if not isinstance(level, int | float):
        return str(level) if level not in ("", None) else "none"
    return f"{unit.factor * level:.4g}"


def _failures(document: CampaignDocument) -> Part:
    if not document.failures:
        return Paragraph("None: every case has a result.")
    rows: list[list[Cell]] = [
        [f.sentence, f.state, str(f.cases), f"failures/{f.example}-*.json"]
        for f in document.failures
    ]
    return Table(
        "", ["sentence", "state", "cases", "log of one"], rows,
        "refused: the input cannot be used; failed: an error in the code; killed: the worker died "
        "each time. A second run begins them again.",
    )  # fmt: skip
