"""Section about a run of the loop: verdict, duration of the ticks, prediction error of the tip."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.core.signals import tip_names
from firmware_py.core.units import ANGLE, FRACTION, LENGTH, PAYLOAD, POSITION, TICK_TIME, TIME
from firmware_py.system.timing import LABELS
from hil.report.build_inputs import LoopRun
from models.predictor.validation import COVERS, coverage_text
from models.shared.drawing import Drawing, Line, plot_lines
from models.shared.pages import Facts, Figure, LegendEntry, Panel, Paragraph, Part, Table
from models.shared.palette import ALARM, BLUE, INK, ORANGE, SPAN

Array = NDArray[np.float64]
Ticks = dict[str, Array]

INTERVALS: Final = 240
"""Intervals of a timeline, of which each shows maximum and median."""
SHOWN_S: Final = 10.0
WHOLE: Final = BLUE
OWN: Final = ORANGE
_PARTS: Final = {
    "all": "all ticks", "in_range": "in range", "out_of_range": "out of range",
    "rest": "rest between motions", "motion": "motion, as in training",
    "glide": "glide to zero after the motion", "stop": "controlled stop",
}  # fmt: skip


def loop_title(loop: LoopRun) -> str:
    line = f"{loop.timing.environment.line} line"
    if loop.dof is None:
        return f"Control loop on the {line}"
    phase = f", phase {ANGLE.number(loop.phase_2_rad, 0)}°" if loop.dof == 2 else ""
    return f"Control loop: {loop.dof}DOF{phase}, {line}"


def loop_parts(loop: LoopRun) -> list[Part]:
    parts: list[Part] = [Paragraph(verdict_sentence(loop)), *loop_figures(loop)]
    if predicted := prediction_table(loop):
        parts.append(predicted)
    if loop.in_real_time:
        parts.append(_duration_table(loop))
    return [*parts, Facts(_environment(loop))]


def verdict_sentence(loop: LoopRun) -> str:
    timing = loop.timing
    if not loop.in_real_time:
        return (
            "On the virtual line the clock is simulated: computation takes no time and a run can "
            "be repeated bit by bit. Durations contain bus time only."
        )
    causes = ", ".join(f"{count} {cause.value}" for cause, count in timing.causes.items() if count)
    lost = (
        f" {timing.misses} of {timing.slots} slots were missed ({causes}; longest run of "
        f"misses {timing.longest_run_of_misses})."
        if causes
        else ""
    )
    bound = FRACTION.text(timing.own_miss_rate_upper_bound_95, 2)
    return (
        f"Verdict: {timing.verdict}; {timing.reason}.{lost} With 95\u00a0% confidence the "
        f"loop itself misses less than {bound} of the deadlines."
    )


def loop_figures(loop: LoopRun) -> list[Figure]:
    """Draw the timing of a run in real time and the prediction error; neither without ticks."""
    if loop.ticks is None:
        return []
    figures = [_timing(loop, loop.ticks)] if loop.in_real_time else []
    if loop.true_tip_m is not None:
        programme_s = loop.timing.run.programme_s
        figures.append(_prediction(loop.ticks, loop.true_tip_m, programme_s))
    return figures


def _timing(loop: LoopRun, ticks: Ticks) -> Figure:
    time_s, period_ms = ticks["time_s"], float(TICK_TIME.shown(loop.timing.targets.period_ns))
    whole_ms = TICK_TIME.shown(ticks["lateness_ns"] + ticks["busy_ns"])
    own_ms = TICK_TIME.shown(ticks["busy_ns"] - ticks["bus_wait_ns"])
    missed = whole_ms > period_ms
    with Drawing() as (drawing, ax):
        plot_lines(ax, _envelope(time_s, whole_ms, WHOLE) + _envelope(time_s, own_ms, OWN))
        ax.plot(time_s[missed], np.full(missed.sum(), period_ms), "v", color=ALARM, markersize=4)
        ax.axhline(period_ms, color=ALARM, linestyle="--", linewidth=1)
        ax.set(
            xlabel=TIME.label("time"), ylabel=TICK_TIME.label("duration"),
            ylim=(0, 1.12 * period_ms), yticks=[0, 5, 10, period_ms],
        )  # fmt: skip
    alt = (
        f"Duration of {len(time_s)} ticks over {time_s[-1] - time_s[0]:.0f} s: the whole tick is "
        f"{np.median(whole_ms):.2f} ms in the median and {whole_ms.max():.2f} ms at most, the own "
        f"cost {own_ms.max():.2f} ms at most; {int(missed.sum())} ticks cross the line at "
        f"{period_ms:g} ms."
    )
    return Figure(
        "Duration of the ticks",
        "Whole tick: from the deadline to the end of the tick. Own cost: without the wake-up "
        "latency and without waiting for the bus. Maximum and median of each interval are shown.",
        [drawing.panel("Timeline", alt)],
        legend=[
            LegendEntry(WHOLE, "whole tick"),
            LegendEntry(OWN, "own cost"),
            LegendEntry(ALARM, f"period, {period_ms:g} ms", "dashed"),
        ],
    )


def _envelope(time_s: Array, values: Array, colour: str) -> list[Line]:
    """Maximum and median of each interval, as a thin and a thick line."""
    groups = np.array_split(np.arange(len(time_s)), min(INTERVALS, len(time_s)))
    middle_s = [float(np.median(time_s[g])) for g in groups]
    largest = [float(np.nanmax(values[g])) for g in groups]
    median = [float(np.nanmedian(values[g])) for g in groups]
    return [Line(middle_s, largest, colour, width=0.6), Line(middle_s, median, colour)]


def _prediction(ticks: Ticks, true_m: Array, programme_s: Mapping[str, float]) -> Figure:
    """Draw predicted and true tip over the first seconds, and their distance over the whole run."""
    time_s = ticks["time_s"]
    predicted_m = np.column_stack([ticks[name] for name in tip_names("predicted_")])
    first = time_s <= time_s[0] + SHOWN_S
    with Drawing() as (drawing, ax):
        low, high = (predicted_m[first, 0] + s * ticks["half_width_x_m"][first] for s in (-1, 1))
        ax.fill_between(time_s[first], low, high, color=WHOLE, alpha=0.18, linewidth=0)
        true, predicted = (
            Line(time_s[first], tip_m[first, 0], colour, dash)
            for tip_m, colour, dash in ((true_m, INK, "solid"), (predicted_m, WHOLE, "dashed"))
        )
        plot_lines(ax, [true, predicted])
        ax.set(xlabel=TIME.label("time"), ylabel=POSITION.label("tip x"))
    tip = drawing.panel(
        f"Tip x, first {SHOWN_S:g} s",
        "Predicted x of the end effector with its 95 % interval, and the true x; "
        f"the true x spans {np.nanmin(true_m[:, 0]):.2f} to {np.nanmax(true_m[:, 0]):.2f} m.",
    )
    distance_mm = LENGTH.shown(np.linalg.norm(predicted_m - true_m, axis=1))
    return Figure(
        "Tip predicted by the robot",
        "From angle, current and estimated DI alone; the true tip is that of the simulated plant "
        "behind the servos. The distance shows maximum and median of each interval.",
        [tip, _distance(time_s, distance_mm, ticks["in_range"] > 0, programme_s)],
        legend=[
            LegendEntry(INK, "true tip"),
            LegendEntry(WHOLE, "prediction and its distance", "dashed"),
            LegendEntry(ALARM, "inputs outside the training range", "dotted"),
            LegendEntry(SPAN, "glide and rest: not in training"),
        ],
    )


def _distance(
    time_s: Array, distance_mm: Array, in_range: NDArray[np.bool_], programme_s: Mapping[str, float]
) -> Panel:
    with Drawing() as (drawing, ax):
        for start_s, end_s in _between_motions(programme_s, float(time_s[-1])):
            ax.axvspan(start_s, end_s, color=SPAN, linewidth=0)
        plot_lines(ax, _envelope(time_s, distance_mm, WHOLE))
        ax.plot(time_s[~in_range], distance_mm[~in_range], ".", color=ALARM, markersize=3)
        ax.set(
            xlabel=TIME.label("time"), ylabel=LENGTH.label("distance"), ylim=(0, None),
            xlim=(time_s[0], time_s[-1]),
        )  # fmt: skip
    return drawing.panel(
        "Distance between predicted and true tip",
        f"It is {np.nanmean(distance_mm):.1f} mm on average and {np.nanmax(distance_mm):.1f} mm "
        f"at most; {int((~in_range).sum())} of {len(time_s)} ticks lie outside the training range.",
    )


def _between_motions(programme_s: Mapping[str, float], end_s: float) -> list[tuple[float, float]]:
    """Spans of the run in which the joints glide to zero or rest."""
    if not programme_s:
        return []
    rest_s, motion_s, _ = programme_s.values()
    cycle_s = sum(programme_s.values())
    starts_s = np.arange(-cycle_s, end_s, cycle_s) + rest_s + motion_s
    return [
        (max(start_s, 0.0), min(start_s + cycle_s - motion_s, end_s))
        for start_s in starts_s.tolist()
        if start_s < end_s
    ]


def prediction_table(loop: LoopRun) -> Table | None:
    """Return the prediction error by part of the run; None if the true tip is unknown."""
    error = loop.timing.prediction_error
    rows = []
    for name, part in {"all": error, **error.parts}.items():
        measured_m = (part.mean_euclidean_distance_m, part.p95_m, part.max_m)
        if distances_m := [value for value in measured_m if value is not None]:
            rows.append(
                [
                    _PARTS.get(name, name), str(part.n), *map(LENGTH.number, distances_m),
                    coverage_text(part.interval_coverage or 0.0,
                                  part.interval_coverage_least or 0.0),
                    FRACTION.text(part.in_range_fraction or 0.0, 1),
                ]
            )  # fmt: skip
    if not rows:
        return None
    return Table(
        f"Distance between predicted and true tip in {LENGTH.name}",
        ["", "ticks", "mean", "95th percentile", "maximum", COVERS, "in range"],
        rows,
        "During glide and rest the link still swings while the joints hardly move. The paper's "
        "polynomial cannot tell to which side: angle, current and DI, which has no sign, do not "
        "show it. The observer's bend does. Where the coverage is below 95\u00a0% the interval is "
        "too narrow.",
    )


def _duration_table(loop: LoopRun) -> Table:
    """Durations of the stages, of the whole tick and of the wake-up, with budgets."""
    timing, parts = loop.timing, loop.timing.tick_budget
    rows = {
        **{f"stage: {name}": durations for name, durations in timing.stages.items()},
        **{f"read: {part}": durations for part, durations in parts.read.items()},
        "slack": parts.slack,
        "whole tick": timing.tick,
        "waiting for the bus": timing.bus_wait,
        "own cost": timing.own_cost,
        "wake-up latency": timing.lateness,
        "wake-up latency of the reference": timing.reference_jitter,
    }
    # The budget of the read is that of its own part, without the wait for the bus.
    budgets = {
        "read: own" if name == "read" else f"stage: {name}": TICK_TIME.number(stage.budget_p99_ns)
        + ("" if stage.within_budget else ", over")
        for name, stage in parts.stages.items()
    }
    return Table(
        f"Durations in {TICK_TIME.name}",
        ["", "n", *LABELS, "budget of p99"],
        [
            [
                name,
                str(d.n),
                *(TICK_TIME.number(getattr(d, field)) for field in LABELS.values()),
                budgets.get(name, ""),
            ]
            for name, d in rows.items()
        ],
    )


def _environment(loop: LoopRun) -> list[tuple[str, str]]:
    """Environment of a run in display units."""
    environment = loop.timing.environment
    units = {"_ns": TICK_TIME, "_kg": PAYLOAD}
    facts = []
    for name, value in msgspec.structs.asdict(environment).items():
        if value in ({}, (), None, "") or (name == "load_is" and not environment.load_processes):
            continue
        text = f"{value:.4g}" if isinstance(value, float) else str(value)
        for suffix, unit in units.items():
            if name.endswith(suffix):
                name, text = name.removesuffix(suffix), unit.significant(value)
        facts.append((name.replace("_", " "), text))
    return facts
