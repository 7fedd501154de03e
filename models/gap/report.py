"""OUT/report.html: one page without outside files, its pictures inline SVG."""

from __future__ import annotations

import html
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from models.gap.close import Diagnosis
from models.gap.locate import Cell
from models.gap.svg import bars, heat_map, traces
from models.gap.waterfall import waterfall_steps
from models.plant.evaluate import compare
from models.trial import Trial
from models.trials import TrialSet

STYLE = """
body{font:15px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#222}
h1{font-size:1.5rem}h2{font-size:1.15rem;margin-top:2rem}.verdict{font-size:1.1rem}
table{border-collapse:collapse;font-size:.9rem}td,th{padding:.2rem .8rem .2rem 0;text-align:left;
border-bottom:1px solid #ddd}td.n{text-align:right}svg{max-width:100%;height:auto}
.note{color:#666;font-size:.9rem}
"""


def write_report(found: Diagnosis, data: dict[str, Any], trials: TrialSet, path: Path) -> Path:
    """Write the page; returns its path."""
    shown = _shown(trials)
    sections = [
        "<h1>The gap between plant and measurement</h1><p class=verdict>"
        f"<b>{_verdict(data)}</b> {html.escape(data['sentence'])}</p>",
        _section(
            "Where it is", _located(found.located),
            "Root mean square residual after the nominal parameters were refitted, in noise "
            "floors: 1 is noise.",
        ),
        _section(
            "What is missing", _named(data) + _evidence(found),
            "d′: distance from a plant without the effect, in standard deviations of the noise "
            "floor.",
        ),
        _section(
            "What the effect takes away", _waterfall(found, trials),
            "Root mean square of all signals in noise floors; values fitted without the trials "
            "that they are tested on.",
        ),
        _section("Before and after", _residuals(found, shown), html.escape(shown.name)),
        _section("Not named", _rejected(data), ""),
    ]  # fmt: skip
    page = (
        f"<!doctype html><html lang=en><meta charset=utf-8><title>Gap</title>"
        f"<style>{STYLE}</style>{''.join(sections)}</html>\n"
    )
    path.write_text(page, encoding="utf-8")
    return path


def _section(title: str, body: str, note: str) -> str:
    return f"<h2>{title}</h2>{body}<p class=note>{note}</p>"


def _verdict(data: dict[str, Any]) -> str:
    names = ", ".join(r["effect"].replace("_", " ") for r in data["named"] if r["kept"])
    return {
        "no gap": "No gap.",
        "closed": f"Closed by {names}.",
        "reduced": f"Reduced by {names}; something is left.",
        "not in the catalogue": "Something is missing that the catalogue does not hold.",
    }[data["verdict"]]


def _located(cells: Sequence[Cell]) -> str:
    shown = [c for c in cells if c.factor != "trial"]
    columns = sorted({f"{c.factor}: {c.level}" for c in shown})
    sizes = {(c.signal, f"{c.factor}: {c.level}"): c.floors for c in shown}
    return heat_map(sorted({c.signal for c in shown}), columns, sizes)


def _named(data: dict[str, Any]) -> str:
    if not data["named"]:
        return "<p>Nothing.</p>"
    rows = []
    for entry in data["named"]:
        values = "<br>".join(
            f"{html.escape(n)} = {q['value']:.4g} ± {q['error'] or 0:.2g} {q['unit']} "
            f"(was {q['before']:.4g})"
            for n, q in entry["parameters"].items()
        )
        alike = ", ".join(c["effect"] for c in entry["look_alikes"]) or "none"
        if entry["look_alikes"]:
            alike += f"; told apart by {entry['separated_by']['motion']}"
        rows.append(
            f"<tr><td>{entry['effect']}</td><td>{values}</td>"
            f"<td class=n>{entry['evidence']['separation']:.1f}</td><td>{alike}</td></tr>"
        )
    head = "<tr><th>effect</th><th>value</th><th>d′</th><th>cannot be told from</th></tr>"
    return f"<table>{head}{''.join(rows)}</table>"


def _evidence(found: Diagnosis) -> str:
    rounds = found.naming.rounds[: max(len(found.naming.chosen), 1)]
    return "".join(
        bars([(" + ".join(c.effects), c.separation) for c in refitted], "d′") for refitted in rounds
    )


def _waterfall(found: Diagnosis, trials: TrialSet) -> str:
    return bars(waterfall_steps(found, trials), "noise floors")


def _rejected(data: dict[str, Any]) -> str:
    rows = "".join(
        f"<tr><td>{r['effect']}</td><td class=n>{r['separation']:.1f}</td>"
        f"<td>{r['reason']}</td></tr>"
        for r in data["rejected"]
    )
    return f"<table><tr><th>effect</th><th>d′</th><th>why</th></tr>{rows}</table>"


def _shown(trials: TrialSet) -> Trial:
    held_out = trials.split()[1]
    return max(held_out or trials, key=lambda t: t.meta.payload_kg)


def _residuals(found: Diagnosis, trial: Trial) -> str:
    before, after = (compare(plant, [trial])[0] for plant in (found.plant, found.improved))
    parts = []
    for signal in before.simulated:
        series = [("before", -before.error(signal)), ("after", -after.error(signal))]
        if np.nanmax(np.abs(series[0][1])) > 0:
            parts.append(traces(signal, trial.time_s, series))
    return "".join(parts)
