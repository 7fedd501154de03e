"""Findings on a whole run: markers held, exchanged or out of place; goals, phase of joint 2."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.display_units import ANGLE, LENGTH
from models.trials.trial import Array, Trial
from models.trials.verdict.finding import ImportFinding
from models.trials.verdict.motion_findings import LEAST_MOTION_RAD
from models.trials.verdict.whole_run.goal_findings import judge_goals
from models.trials.verdict.whole_run.held_markers import held_markers
from models.trials.verdict.whole_run.marker_distances import misplaced_markers

MOST_NAMED: Final = 4
"""Most findings of one kind that are listed one by one."""
PHASE_RAD: Final = 0.3
"""Difference of the goals' phase from the declared one that causes a warning."""
SINUSOIDAL: Final = 0.9
"""Smallest fraction of a goal's variance in a sine of the period that defines its phase."""


def judge_run(trial: Trial) -> list[ImportFinding]:
    """Findings on the markers over a whole trial, and on its goals."""
    found = [*judge_goals(trial), *_phase(trial)]
    markers_m = trial.markers_m
    if not np.isfinite(markers_m).any():
        return found
    names, time_s = trial.meta.layout.names, trial.time_s
    held = held_markers(trial)
    texts = []
    for h in held:
        markers_m[h.first : h.last + 1, list(h.places)] = np.nan
        verb = "holds its position" if len(h.places) == 1 else "hold their positions"
        meanwhile = "the link moves" if len(h.places) == len(names) else "the neighbours move"
        texts.append(
            f"{_listed(names, h.places)} {verb} {_rows(np.arange(h.first, h.last + 1), time_s)}, "
            f"while {meanwhile} by {LENGTH.text(h.moved_m, 0)}"
        )
    found += _findings(texts, "held", "leave these cells empty where the marker was not seen")
    texts, swapped = [], []
    for m in misplaced_markers(markers_m, trial.meta.layout, trial.meta.rest_samples):
        where = _rows(m.rows, time_s)
        if m.exchanged:
            swapped.append(f"{_listed(names, m.places)} are exchanged {where}")
            continue
        verb = "is" if len(m.places) == 1 else "are"
        texts.append(
            f"{_listed(names, m.places)} {verb} out of place {where}: distances to the neighbours "
            f"are wrong by up to {LENGTH.text(m.off_m, 0)}"
        )
    found += _findings(swapped, "swapped", "exchange them in these rows and correct the tip")
    return found + _findings(
        texts, "place", "leave these cells empty, or label the markers again and export anew"
    )


def _findings(texts: Sequence[str], cause: str, remedy: str) -> list[ImportFinding]:
    """A warning for each text; many of one kind are counted."""
    told = list(texts[:MOST_NAMED])
    if len(texts) > MOST_NAMED:
        told[-1] += f"; and {len(texts) - MOST_NAMED} times more in this trial"
    return [ImportFinding("warning", cause, text, remedy) for text in told]


def _listed(names: Sequence[str], places: Iterable[int]) -> str:
    """Names of markers in words."""
    listed = [names[k] for k in places]
    if len(listed) == len(names) > 1:
        return "all markers"
    return " and ".join(filter(None, [", ".join(listed[:-1]), listed[-1]]))


def _rows(rows: NDArray[np.intp], time_s: Array) -> str:
    """Rows in words, counted as in the trial's file: its header is row 1."""
    first, last = int(rows[0]), int(rows[-1])
    if first == last:
        return f"in row {first + 2} ({time_s[first]:.2f} s)"
    of = "" if len(rows) == last - first + 1 else f"{len(rows)} of the "
    return f"in {of}rows {first + 2} to {last + 2} ({time_s[first]:.2f} s to {time_s[last]:.2f} s)"


def _phase(trial: Trial) -> list[ImportFinding]:
    """Finding if joint 2 leads joint 1 by another phase than the conditions state."""
    meta = trial.meta
    if meta.dof != 2 or meta.motion != "sinusoid":
        return []
    # The second half of the first cycle and the first half of the second: joint 2 is faded in.
    start_s = trial.time_s[min(meta.rest_samples, len(trial) - 1)] + 0.5 * meta.period_s
    cycle = (trial.time_s >= start_s) & (trial.time_s < start_s + meta.period_s)
    if trial.time_s[-1] < start_s + 0.9 * meta.period_s or cycle.sum() < 8:
        return []
    turn = 2 * np.pi * (trial.time_s[cycle] - start_s) / meta.period_s
    design = np.column_stack([np.ones_like(turn), np.sin(turn), np.cos(turn)])
    phases = []
    for goal in trial.goal_rad[cycle].T:
        terms, *_ = np.linalg.lstsq(design, goal, rcond=None)
        left = np.var(goal - design @ terms)
        if np.std(goal) < LEAST_MOTION_RAD or left > (1 - SINUSOIDAL) * np.var(goal):
            return []
        phases.append(np.arctan2(terms[2], terms[1]))
    lead = float(phases[1] - phases[0])
    off = float(np.angle(np.exp(1j * (lead - meta.phase_2_rad))))
    if abs(off) <= PHASE_RAD:
        return []
    shown = float(np.angle(np.exp(1j * (lead + 1e-9))))
    return [
        ImportFinding(
            "warning", "phase",
            f"goal 2 leads goal 1 by {ANGLE.text(shown, 0)}, phase_2_rad says "
            f"{ANGLE.text(meta.phase_2_rad, 0)}",
            f"set phase_2_rad = {shown:.4g} under [trial], or correct the sign of a goal",
        )
    ]  # fmt: skip
