"""Page of `bench.real`: verdicts, named effects, fits side by side, curves."""

from __future__ import annotations

import html
import io
from pathlib import Path
from typing import Any, Final

from firmware_py.display_units import ANGLE_ERROR, LENGTH, TIME, signal_unit, signal_words
from models.plant.identification.evaluation import Comparison, compare_with_trials
from models.plant.plant import read_plant
from models.shared.html_page import Section, page_of, table_of
from models.shared.palette import MUTED, SIMULATED
from models.shared.svg_charts import legend
from models.trials.trial_files import read_trials

COLUMNS: Final = 3
SHOWN_ROWS: Final = 400
UNITS: Final = {unit.name: unit for unit in (ANGLE_ERROR, LENGTH)}
MEASURE: Final = {"mae": "mean absolute error", "rms": "root mean square error"}


def write_real_page(data: dict[str, Any], out: Path) -> Path:
    """Write OUT/real.html; returns its path."""
    verdicts = table_of(
        ("figure", "value", "at most", ""),
        [
            (html.escape(v["limit"]), f"{v['value']:.3g}", f"{v['at_most']:g}",
             "met" if v["met"] else "missed")
            for v in data["verdicts"]
        ],
    )  # fmt: skip
    parts = [Section("verdicts", "Verdicts", verdicts)]
    parts += [_system(name, system, out / name) for name, system in data["systems"].items()]
    path = out / "real.html"
    opening = "<p>Recordings of others, imported, identified and diagnosed by our commands.</p>"
    path.write_text(page_of("Measured data", opening, parts), encoding="utf-8")
    return path


def _system(name: str, system: dict[str, Any], out: Path) -> Section:
    """Named effects, fits and trials of one system."""
    rounds = "; ".join(" + ".join(names) or "nothing more" for names in system["rounds"])
    shown = UNITS[system["unit"]]
    fits = table_of(
        ("fit", shown.label("all trials"), shown.label("condition left out")),
        [
            (html.escape(label), shown.number(row["all"]),
             shown.number(row["left_out"]) if "left_out" in row else "")
            for label, row in system["fits"].items()
        ],
        MEASURE[system["measure"]],
    )  # fmt: skip
    values = table_of(
        ("parameter", "value", "standard error", "unit"),
        [
            (html.escape(n), f"{q['value']:.4g}", f"{q['error']:.1g}", html.escape(q["unit"]))
            for n, q in system["parameters"].items()
        ],
        "identified",
    )
    plant = read_plant(out / "plant.json")
    picture = _picture(compare_with_trials(plant, read_trials(out / "trials", plant.signals)))
    body = f"<p>Named, round by round: {html.escape(rounds)}.</p>{fits}{values}{picture}"
    return Section(name, plant.name, body)


def _picture(comparisons: list[Comparison]) -> str:
    """Measured and simulated coordinate of every trial as one SVG."""
    from matplotlib import pyplot

    from models.shared.svg_drawing import STYLE  # loads matplotlib

    columns = min(COLUMNS, len(comparisons))
    rows = -(-len(comparisons) // columns)
    text = io.StringIO()
    with pyplot.rc_context(STYLE):
        figure, axes = pyplot.subplots(
            rows, columns, squeeze=False, figsize=(3.2 * columns, 1.9 * rows), layout="constrained"
        )
        for axis, c in zip(axes.flat, comparisons, strict=False):
            every = max(1, len(c.trial) // SHOWN_ROWS)
            (signal,) = (s for s in c.simulated if s in ("angle_1_rad", "position_1_m"))
            unit = signal_unit(signal)
            for values, colour, width in (
                (c.measured[signal], MUTED, 2.0),
                (c.simulated[signal], SIMULATED, 0.9),
            ):
                shown = unit.shown(values[::every])
                axis.plot(c.trial.time_s[::every], shown, color=colour, lw=width)
            axis.set_title(c.trial.name, fontsize=8)
            axis.set_ylabel(unit.label(signal_words(signal)), fontsize=7)
            axis.set_xlabel(TIME.label("time"), fontsize=7)
            axis.tick_params(labelsize=7)
        figure.savefig(text, format="svg", metadata={"Date": None})
        pyplot.close(figure)
    drawn = text.getvalue()
    return f"<figure>{drawn[drawn.index('<svg') :]}</figure>" + legend(
        [(MUTED, "measured"), (SIMULATED, "plant")]
    )
