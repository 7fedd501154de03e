"""Page of a campaign: figures of its results over each axis, conditions, failures, costs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import numpy as np

from firmware_py.core.signals import unit_of
from firmware_py.core.units import (
    DATA_SIZE,
    PRESSURE,
    DisplayUnit,
    error_unit,
    signal_unit,
    signal_words,
)
from hil.campaign.campaign_cases import CampaignCase
from hil.campaign.campaign_document import CampaignDocument
from hil.campaign.campaign_spec import CampaignSpec, axis_names, draw_axes, flat, grid_axes
from hil.campaign.campaign_summary import SummaryRow, summary_rows
from hil.campaign.kinds.case_kind import CaseKind
from hil.campaign.result_store import ResultStore
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


def write_campaign_page(
    document: CampaignDocument,
    spec: CampaignSpec,
    kind: CaseKind[Any],
    cases: Sequence[CampaignCase],
    store: ResultStore,
    path: Path,
) -> None:
    wanted = {*axis_names(spec)}
    rows = [_slim(row, wanted, kind.figures) for row in summary_rows(cases, store)]
    source = SOURCES.get(kind.name, f"cases of the kind {kind.name}")
    done = document.states.get("done", 0)
    lead: list[Part] = [
        SIMULATED if kind.name in SOURCES else UNKNOWN,
        Paragraph(f"{done} of {document.cases} {source} have a result.", "lead"),
    ]
    figures = {
        n: w for n, w in kind.figures.items() if any(_number(r, n) is not None for r in rows)
    }
    sections = [
        Section("figures", "Figures of all cases", [_overall(figures, rows)]),
        *(_axis_section(spec, name, figures, rows) for name in _varied(spec)),
        Section("conditions", "Conditions", [_conditions(spec, kind)]),
        Section("failures", "Cases without a result", [_failures(document)]),
        Section("costs", "Costs", [_costs(store, document.code)]),
    ]
    title = f"Campaign: {spec.name}" if spec.name else f"Campaign of {kind.name}"
    page = render_page(title, lead, sections, datetime.now(UTC))
    path.write_text(page, encoding="utf-8")


def _slim(row: SummaryRow, axes: set[str], figures: Mapping[str, str]) -> SummaryRow:
    """Reduce a row to the values that the page shows, to save memory in a large campaign."""
    config = {n: v for n, v in row.config.items() if _owner(n, axes)}
    result = {n: v for n, v in row.result.items() if n in figures}
    return SummaryRow(row.key, row.state, row.sentence, config, result)


def _owner(name: str, axes: set[str]) -> bool:
    return any(name == axis or name.startswith(f"{axis}.") for axis in axes)


def _number(row: SummaryRow, name: str) -> float | None:
    value = row.result.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if math.isfinite(value) else None


def _unit(name: str) -> DisplayUnit:
    last = name.rpartition(".")[2]
    if last == "di":
        return signal_unit(last)
    if last.endswith(("_fraction", "coverage", "coverage_least", "right")):
        return error_unit("1")
    if last.endswith("ticks"):
        return DisplayUnit("", 1.0, 0)
    if (unit := unit_of(last)) in ("m", "rad"):
        return error_unit(unit)
    return DisplayUnit(signal_unit(last).name, signal_unit(last).factor, 2)


def _overall(figures: Mapping[str, str], rows: Sequence[SummaryRow]) -> Part:
    if not figures:
        return Paragraph("No case has a result yet.", "missing")
    table: list[list[Cell]] = []
    for name, words in figures.items():
        values = [v for r in rows if (v := _number(r, name)) is not None]
        table.append([_unit(name).label(words), *_quantiles(values, name), str(len(values))])
    return Table("", ["", "smallest", "median", "90 %", "largest", "cases"], table)


def _quantiles(values: Sequence[float], name: str) -> list[Cell]:
    if not values:
        return [NO_VALUE] * 4
    return [_unit(name).number(v) for v in np.quantile(values, [0.0, 0.5, 0.9, 1.0])]


def _varied(spec: CampaignSpec) -> list[str]:
    """Axes with more than one value; the others are conditions common to all cases."""
    alone = {name for name, values in grid_axes(spec.grid).items() if len(values) == 1}
    return [name for name in axis_names(spec) if name not in alone]


def _conditions(spec: CampaignSpec, kind: CaseKind[Any]) -> Part:
    """Conditions in the campaign's file: fixed values, axes of the grid, and draws."""
    rows = [("kind", kind.name)]
    rows += [(name, _in_words(name, value)) for name, value in flat(spec.fixed).items()]
    for name, values in grid_axes(spec.grid).items():
        shown = [_in_words(name, v) for v in values[:MOST_LEVELS]]
        more = [f"{len(values)} in all"] if len(values) > MOST_LEVELS else []
        rows.append((name, ", ".join(shown + more)))
    for name, (form, limits) in draw_axes(spec.draw).items():
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


def _axis_words(axis: str) -> str:
    """Words for an axis: "payload" for "payload_kg", "faults: lost" for "faults.lost"."""
    return ": ".join(signal_words(part) for part in axis.split("."))


def _axis_section(
    spec: CampaignSpec, axis: str, figures: Mapping[str, str], rows: Sequence[SummaryRow]
) -> Section:
    values, words = [_value_of(row, axis) for row in rows], _axis_words(axis)
    levels = list(dict.fromkeys(values))
    form = draw_axes(spec.draw).get(axis, ("", []))[0]
    numbers = all(isinstance(v, int | float) for v in values)
    parts: list[Part] = []
    if not figures:
        parts = [Paragraph("No case has a result yet.", "missing")]
    elif len(levels) <= MOST_LEVELS and not form.endswith("uniform"):
        parts = [_level_table(axis, words, levels, values, figures, rows)]
    elif numbers and not words.endswith("seed"):
        panels = [
            panel
            for name, figure in figures.items()
            if (panel := _points(axis, words, (name, figure), values, rows, form))
        ]
        parts = [Figure("", "One point a case.", panels)]
    else:
        parts = [Paragraph(f"{len(levels)} values, each case of its own: see summary.csv.")]
    return Section(f"axis-{axis.replace('.', '-')}", f"By {words}", parts)


def _value_of(row: SummaryRow, axis: str) -> Any:
    """Value of an axis; a table, such as effects, as text."""
    if axis in row.config:
        return row.config[axis]
    inside = {n.removeprefix(f"{axis}."): v for n, v in row.config.items() if n != axis}
    own = {n: v for n, v in inside.items() if f"{axis}.{n}" in row.config}
    return ", ".join(f"{n} {v:g}" if isinstance(v, float) else f"{n} {v}" for n, v in own.items())


def _level_table(
    axis: str, words: str, levels: Sequence[Any], values: Sequence[Any],
    figures: Mapping[str, str], rows: Sequence[SummaryRow],
) -> Part:  # fmt: skip
    unit = _axis_unit(axis)
    table: list[list[Cell]] = []
    for level in levels:
        own = [row for row, value in zip(rows, values, strict=True) if value == level]
        cells: list[Cell] = [_level_text(level, unit)]
        for name in figures:
            numbers = [v for r in own if (v := _number(r, name)) is not None]
            pair = (
                [_unit(name).number(v) for v in np.quantile(numbers, [0.5, 0.9])] if numbers else []
            )
            cells.append(" / ".join(pair) or NO_VALUE)
        done = sum(row.state == "done" for row in own)
        cells.append(TableCell(f"{done} of {len(own)}", None if done == len(own) else False))
        table.append(cells)
    header = [unit.label(words), *(_unit(n).label(w) for n, w in figures.items()), "with result"]
    return Table("", header, table, "Median and 90th percentile over the cases of each row.")


def _level_text(level: Any, unit: DisplayUnit) -> str:
    if isinstance(level, bool):
        return "yes" if level else "no"
    if not isinstance(level, int | float):
        return str(level) if level not in ("", None) else "none"
    return f"{unit.factor * level:.4g}"


def _points(
    axis: str, words: str, shown: tuple[str, str], values: Sequence[Any],
    rows: Sequence[SummaryRow], form: str,
) -> Panel | None:  # fmt: skip
    name, figure = shown
    pairs = [
        (x, y) for x, r in zip(values, rows, strict=True) if (y := _number(r, name)) is not None
    ]
    if not pairs:
        return None
    step = max(len(pairs) // MOST_POINTS, 1)
    x, y = np.array(pairs[::step], dtype=float).T
    unit = _axis_unit(axis)
    with Drawing() as (drawing, ax):
        ax.plot(unit.shown(x), _unit(name).shown(y), ".", color=BLUE, ms=3, alpha=0.6)
        if form == "log_uniform":
            ax.set_xscale("log")
        ax.set(xlabel=unit.label(words), ylabel=_unit(name).label(figure))
    middle, most = _unit(name).text(np.median(y)), _unit(name).text(y.max())
    return drawing.panel(figure, f"{figure} over {words}: median {middle}, largest {most}.")


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


def _costs(store: ResultStore, code: str) -> Part:
    costs = [row for row in store.read_costs() if row["code"] == code]
    if not costs:
        return Paragraph("No case of this code ran here.", "missing")
    cpu_s = np.array([float(row["cpu_s"]) for row in costs])
    memory = max(int(row["memory_bytes"]) for row in costs)
    return Facts(
        [
            ("code", code),
            ("cases that ran", str(len(costs))),
            ("workers", str(len({row["worker"] for row in costs}))),
            ("processor time of a case", f"{np.median(cpu_s):.2f} s (median), "
             f"{np.quantile(cpu_s, 0.95):.2f} s (95 %)"),
            ("processor time of all", f"{cpu_s.sum() / 60:.1f} min"),
            ("memory of a worker", DATA_SIZE.text(memory)),
        ]
    )  # fmt: skip
