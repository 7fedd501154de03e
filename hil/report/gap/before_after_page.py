"""The page of a gap: what was hidden and what became of it, around the diagnosis's own sections."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from hil.report.build_inputs import LoopRun
from hil.report.gap.gap_curves import key, robot_curves, unit_curves
from hil.report.gap.gap_figures import judged_of, same_in_python
from hil.report.gap.gap_inputs import GapInputs
from hil.report.report_tables import NO_VALUE, percent
from models.gap.report.gap_page import gap_lead, gap_sections, short_signal
from models.shared.html_page import Section, page_of, panels_of, readable, table_of

HEADINGS: Final = {
    "before": "before", "retrained": "new data, old plant", "after": "after",
    "without": "effect-free",
}  # fmt: skip


def render_gap(inputs: GapInputs, data: Mapping[str, Any], hidden: Mapping[str, float]) -> str:
    """The whole page as HTML; `data` as `gap_figures.summary` gives it."""
    *own, others = gap_sections(inputs.found, inputs.before, inputs.after, inputs.trials, hidden)
    parts = [
        Section(
            "glance", "At a glance", _glance(data),
            "Hidden and found strength need not agree within the fit's error: the laboratory has "
            "equations of its own.",
        ),
        *own,
        _unit(inputs, data["unit"]),
        _robot(inputs),
        others,
        Section("made", "How it was made", _commands(inputs.commands)),
    ]  # fmt: skip
    opening = gap_lead(inputs.found) + f"<p>{_told(data)}</p>"
    return page_of("A hidden effect, from trial to robot", opening, parts)


def _told(data: Mapping[str, Any]) -> str:
    """What was hidden beside what was named."""
    said = [row["said"] for row in data["hidden"].values()] or ["nothing was hidden"]
    said += [f"{e.replace('_', ' ')} was named without being hidden" for e in data["also_named"]]
    text = "; ".join(said)
    return html.escape(f"{text[0].upper()}{text[1:]}.")


def _glance(data: Mapping[str, Any]) -> str:
    variants = ("before", "after", "without")
    robot, heaviest = data["robot"], data["robot_heaviest"]
    distances = {
        "Rebuilt twin in FMPy, tip RMS on a motion that nothing was fitted to":
            (data["unit"]["tip_rms_m"], data["unit"]["share_removed"]),
        "Robot in the loop, mean distance of the predicted from the true tip":
            (robot["tip_mean_m"], robot["share_removed"]),
        f"The same at {data['heaviest_kg']:g}\u00a0kg":
            (heaviest["tip_mean_m"], heaviest["share_removed"]),
    }  # fmt: skip
    rows = [
        [name, *(_mm(error.get(v)) for v in variants), _percent(share)]
        for name, (error, share) in distances.items()
    ]
    covered = heaviest["interval_coverage"]
    rows.append(
        ["and there its 95 % interval covers", *(_percent(covered.get(v)) for v in variants), ""]
    )
    return table_of(["", *(HEADINGS[v] for v in variants), "gap gone"], rows)


def _unit(inputs: GapInputs, data: Mapping[str, Any]) -> Section:
    """The twin units in FMPy over the sealed trials."""
    runs = inputs.units
    heaviest_kg = max(runs["before"])
    units = runs["before"][heaviest_kg]["units"]
    signals = [s for s in runs["before"][heaviest_kg]["rms"] if not s.startswith("predicted_")]
    rows = [
        [html.escape(short_signal(signal)),
         *(readable(float(np.sqrt(np.mean([r["rms"][signal] ** 2 for r in of.values()]))),
                    units[signal]) for of in runs.values())]
        for signal in signals
    ]  # fmt: skip
    return Section(
        "unit", "The rebuilt unit in FMPy",
        table_of(["root mean square error", *(HEADINGS[v] for v in runs)], rows)
        + key() + panels_of(unit_curves(inputs, heaviest_kg)),
        f"Twin units, driven in FMPy by the goals of {len(inputs.sealed)} trials of another motion "
        "that neither identification nor diagnosis saw: "
        f"{same_in_python(data['worst_difference'])}. In the last column the same trials were run "
        "without the effect: what the plant before leaves there is about the least that can be "
        f"left. fmu check finds the rebuilt unit {'sound' if data['sound'] else 'not sound'}. "
        f"Curves: measured minus simulated at {heaviest_kg:g}\u00a0kg.",
    )  # fmt: skip


def _robot(inputs: GapInputs) -> Section:
    """What the robot predicted of its own tip, with each bundle."""
    loops = inputs.loops
    payloads = sorted(loops["before"])
    rows = [
        [f"{kg:g}\u00a0kg", *(_judged(of.get(kg)) for of in loops.values())] for kg in payloads
    ]  # fmt: skip
    return Section(
        "robot", "The robot's own prediction",
        "<p>Mean distance of the predicted from the true tip in motion, and how often the "
        "95 % interval covers it:</p>"
        + table_of(["payload", *(HEADINGS[v] for v in loops)], rows)
        + key() + panels_of(robot_curves(inputs, payloads[-1])),
        "The robot's loop and emulated servos on a simulated line; behind them the laboratory with "
        "what is hidden in it, its variation drawn anew. The robot reads angle and current and "
        "predicts its tip, the laboratory knows where it is. “New data, old plant”: "
        "a bundle trained on the same new trials as the one after, but its observer is still the "
        "plant's before; what measuring again does by itself. Curves: predicted minus true at "
        f"{payloads[-1]:g}\u00a0kg.",
    )  # fmt: skip


def _judged(loop: LoopRun | None) -> str:
    part = judged_of(loop) if loop else None
    if part is None:
        return NO_VALUE
    return f"{_mm(part['mean_euclidean_distance_m'])}, {percent(part['interval_coverage'])}"


def _commands(commands: Sequence[str]) -> str:
    """What made all this, folded away: on a phone it is longer than the rest."""
    rows = "".join(f"<li><code>{html.escape(command)}</code></li>" for command in commands)
    return (
        f"<details><summary>{len(commands)} commands</summary>"
        f'<ol class="commands">{rows}</ol></details>'
    )


def _mm(value_m: float | None) -> str:
    return NO_VALUE if value_m is None else f"{1e3 * value_m:.1f}\u00a0mm"


def _percent(share: float | None) -> str:
    return NO_VALUE if share is None else percent(share)
