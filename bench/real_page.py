"""Page of `bench.real`: verdicts, named effects, fits side by side, curves."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from firmware_py.display_units import (
    ANGLE_ERROR,
    LENGTH,
    TIME,
    signal_unit,
    signal_words,
    symbol_of,
)
from models.plant.identification.evaluation import Comparison, compare_with_trials
from models.plant.plant import read_plant
from models.shared.html_page import render_page
from models.shared.page_parts import (
    Figure,
    LegendEntry,
    Panel,
    Paragraph,
    Section,
    Table,
    TableCell,
)
from models.shared.palette import MUTED, SIMULATED
from models.shared.svg_drawing import Drawing
from models.trials.origin_notice import origin_notice
from models.trials.trial_files import read_trials
from models.trials.trial_origin import TrialOrigin

SHOWN_ROWS: Final = 400
SHOWN_SIGNALS: Final = ("angle_1_rad", "position_1_m", "deflection_1_rad")
UNITS: Final = {unit.name: unit for unit in (ANGLE_ERROR, LENGTH)}
MEASURE: Final = {"mae": "mean absolute error", "rms": "root mean square error"}


def write_real_page(data: dict[str, Any], out: Path) -> Path:
    """Write OUT/real.html; returns its path."""
    verdicts = Table(
        "", ("figure", "value", "at most"),
        [
            (v["limit"], TableCell(f"{v['value']:.3g}", v["met"]), f"{v['at_most']:g}")
            for v in data["verdicts"]
        ],
    )  # fmt: skip
    sections = [Section("verdicts", "Verdicts", [verdicts])]
    sections += [_system(name, system, out / name) for name, system in data["systems"].items()]
    path = out / "real.html"
    lead = [
        origin_notice((TrialOrigin("measured"),)),
        Paragraph("Published recordings, imported, identified and diagnosed.", "lead"),
    ]
    path.write_text(render_page("Measured data", lead, sections), encoding="utf-8")
    return path


def _system(name: str, system: dict[str, Any], out: Path) -> Section:
    """Named effects, fits and trials of one system."""
    rounds = "; ".join(" + ".join(names) or "nothing more" for names in system["rounds"])
    shown = UNITS[system["unit"]]
    left_out = list(next(iter(system["fits"].values())).get("left_out_by", {}))
    fits = Table(
        MEASURE[system["measure"]],
        ("fit", shown.label("all trials"),
         *(shown.label(f"each {what} left out in turn") for what in left_out)),
        [
            (label, shown.number(row["all"]),
             *(shown.number(row["left_out_by"][what]) for what in left_out))
            for label, row in system["fits"].items()
        ],
    )  # fmt: skip
    values = Table(
        "Identified parameters", ("parameter", "value", "standard error", "unit"),
        [
            (n, f"{q['value']:.4g}", f"{q['error']:.1g}", symbol_of(q["unit"]))
            for n, q in system["parameters"].items()
        ],
    )  # fmt: skip
    plant = read_plant(out / "plant.json")
    picture = Figure(
        "Measured and simulated", "",
        _panels(compare_with_trials(plant, read_trials(out / "trials", plant.signals))),
        legend=[LegendEntry(MUTED, "measured"), LegendEntry(SIMULATED, "plant")],
    )  # fmt: skip
    named = Paragraph(f"Effects named, round by round: {rounds}.")
    return Section(name, plant.name, [named, fits, values, picture])


def _panels(comparisons: list[Comparison]) -> list[Panel]:
    """Measured and simulated coordinate of every trial."""
    panels = []
    for c in comparisons:
        every = max(1, len(c.trial) // SHOWN_ROWS)
        signal = next(s for s in c.simulated if s in SHOWN_SIGNALS)
        unit = signal_unit(signal)
        with Drawing(2.2) as (drawing, ax):
            for values, colour, width in (
                (c.measured[signal], MUTED, 2.0),
                (c.simulated[signal], SIMULATED, 0.9),
            ):
                shown = unit.shown(values[::every])
                ax.plot(c.trial.time_s[::every], shown, color=colour, lw=width)
            ax.set(xlabel=TIME.label("time"), ylabel=unit.label(signal_words(signal)))
        alt = f"{signal_words(signal)} of trial {c.trial.name}, measured and simulated."
        panels.append(drawing.panel(c.trial.name, alt))
    return panels
