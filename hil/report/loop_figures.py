"""Figures of a run of the loop: duration of the ticks, and prediction error of the tip."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.signals import tip_names
from firmware_py.core.units import LENGTH, POSITION, TICK_TIME, TIME
from firmware_py.system.timing import LABELS
from hil.report.build_inputs import LoopRun
from models.shared.drawing import Drawing
from models.shared.pages import Figure, LegendEntry, Panel, Table
from models.shared.palette import ALARM, BLUE, INK, ORANGE, SPAN

Array = NDArray[np.float64]
Ticks = dict[str, Array]

BINS: Final = 240
SHOWN_S: Final = 10.0
WHOLE: Final = BLUE
OWN: Final = ORANGE


def loop_figures(loop: LoopRun) -> list[Figure]:
    """Draw the timing of a run in real time and the prediction error; neither without ticks."""
    if loop.ticks is None:
        return []
    figures = [_timing(loop, loop.ticks)] if loop.in_real_time else []
    if loop.true_tip_m is not None:
        programme = loop.timing.run.programme_s
        figures.append(_prediction(loop.ticks, loop.true_tip_m, programme))
    return figures


def _timing(loop: LoopRun, ticks: Ticks) -> Figure:
    period_ms = float(TICK_TIME.shown(loop.timing.targets.period_ns))
    whole_ms = TICK_TIME.shown(ticks["lateness_ns"] + ticks["busy_ns"])
    own_ms = TICK_TIME.shown(ticks["busy_ns"] - ticks["bus_wait_ns"])
    return Figure(
        "Duration of the ticks",
        "Whole tick: from the deadline to the end of the tick. Own cost: without the wake-up "
        "latency and without waiting for the bus. The timeline shows maximum and median of each "
        "interval.",
        [
            _timeline(ticks["time_s"], whole_ms, own_ms, period_ms),
            _histogram(whole_ms, own_ms, period_ms),
        ],
        legend=[
            LegendEntry(WHOLE, "whole tick"),
            LegendEntry(OWN, "own cost"),
            LegendEntry(ALARM, f"period, {period_ms:g} ms", "dashed"),
        ],
    )


def _timeline(time_s: Array, whole_ms: Array, own_ms: Array, period_ms: float) -> Panel:
    groups = np.array_split(np.arange(len(time_s)), min(BINS, len(time_s)))
    middle_s = [float(np.median(time_s[g])) for g in groups]
    missed = whole_ms > period_ms
    with Drawing() as (drawing, ax):
        for values, colour in ((whole_ms, WHOLE), (own_ms, OWN)):
            slowest = [float(values[g].max()) for g in groups]
            ax.plot(middle_s, slowest, color=colour, linewidth=0.7, alpha=0.7)
            ax.plot(middle_s, [float(np.median(values[g])) for g in groups], color=colour)
        ax.plot(time_s[missed], np.full(missed.sum(), period_ms), "v", color=ALARM, markersize=4)
        ax.axhline(period_ms, color=ALARM, linestyle="--", linewidth=1)
        ax.set(
            xlabel=TIME.label("time"),
            ylabel=TICK_TIME.label("duration"),
            ylim=(0, 1.12 * period_ms),
        )
        ax.set_yticks([0, 5, 10, period_ms])
    return drawing.panel(
        "Timeline",
        f"Duration of {len(time_s)} ticks over {time_s[-1] - time_s[0]:.0f} s: the whole tick is "
        f"{np.median(whole_ms):.2f} ms in the median and {whole_ms.max():.2f} ms at most, the own "
        f"cost {own_ms.max():.2f} ms at most; {int(missed.sum())} ticks cross the line at "
        f"{period_ms:g} ms.",
    )


def _histogram(whole_ms: Array, own_ms: Array, period_ms: float) -> Panel:
    edges = np.linspace(0, 1.12 * period_ms, 96)
    with Drawing() as (drawing, ax):
        for values, colour in ((whole_ms, WHOLE), (own_ms, OWN)):
            counts, _ = np.histogram(np.minimum(values, edges[-1]), edges)
            ax.stairs(counts, edges, fill=True, color=colour, alpha=0.3)
            ax.stairs(counts, edges, color=colour, linewidth=1)
        ax.axvline(period_ms, color=ALARM, linestyle="--", linewidth=1)
        ax.set(
            xlabel=TICK_TIME.label("duration"), ylabel="ticks", yscale="log", xlim=(0, edges[-1])
        )
        ax.set_xticks([0, 5, 10, period_ms])
        ax.set_ylim(0.7, None)
        ax.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        ax.yaxis.set_minor_formatter(lambda value, _: "")
    return drawing.panel(
        "Histogram",
        f"Histogram of {len(whole_ms)} ticks: 99 % of the whole ticks last at most "
        f"{np.percentile(whole_ms, 99):.2f} ms, 99 % of the own cost at most "
        f"{np.percentile(own_ms, 99):.2f} ms, against a period of {period_ms:g} ms.",
    )


def _prediction(ticks: Ticks, true_m: Array, programme: Mapping[str, float]) -> Figure:
    """Draw predicted and true tip over the first seconds, and their distance over the whole run."""
    time_s = ticks["time_s"]
    predicted_m = np.column_stack([ticks[name] for name in tip_names("predicted_")])
    distance_mm = LENGTH.shown(np.linalg.norm(predicted_m - true_m, axis=1))
    first = time_s <= time_s[0] + SHOWN_S
    with Drawing() as (drawing, ax):
        low, high = (predicted_m[:, 0] + sign * ticks["half_width_x_m"] for sign in (-1, 1))
        ax.fill_between(
            time_s[first], low[first], high[first], color=WHOLE, alpha=0.18, linewidth=0
        )
        ax.plot(time_s[first], true_m[first, 0], color=INK)
        ax.plot(time_s[first], predicted_m[first, 0], color=WHOLE, linestyle="--")
        ax.set(xlabel=TIME.label("time"), ylabel=POSITION.label("tip x"))
    tip = drawing.panel(
        f"Tip x, first {SHOWN_S:g} s",
        "Predicted x of the end effector with its 95 % interval, and the true x; "
        f"the true x spans {np.nanmin(true_m[:, 0]):.2f} to {np.nanmax(true_m[:, 0]):.2f} m.",
    )
    return Figure(
        "Tip predicted by the robot",
        "From angle, current and estimated DI alone; the true tip is that of the simulated plant "
        "behind the servos. The distance shows maximum and median of each interval.",
        [tip, _distance(time_s, distance_mm, ticks["in_range"] > 0, programme)],
        legend=[
            LegendEntry(INK, "true tip"),
            LegendEntry(WHOLE, "prediction and its distance", "dashed"),
            LegendEntry(ALARM, "inputs outside the training range", "dotted"),
            LegendEntry(SPAN, "glide and rest: not in training"),
        ],
    )


def _distance(
    time_s: Array, distance_mm: Array, in_range: NDArray[np.bool_], programme: Mapping[str, float]
) -> Panel:
    groups = np.array_split(np.arange(len(time_s)), min(BINS, len(time_s)))
    with Drawing() as (drawing, ax):
        for start_s, end_s in _between_motions(programme, float(time_s[-1])):
            ax.axvspan(start_s, end_s, color=SPAN, linewidth=0)
        middle_s = [float(np.median(time_s[g])) for g in groups]
        for statistic, width, alpha in ((np.nanmax, 0.7, 0.7), (np.nanmedian, 1.4, 1.0)):
            values = [float(statistic(distance_mm[g])) for g in groups]
            ax.plot(middle_s, values, color=WHOLE, linewidth=width, alpha=alpha)
        outside = ~in_range
        ax.plot(time_s[outside], distance_mm[outside], ".", color=ALARM, markersize=3)
        ax.set(xlabel=TIME.label("time"), ylabel=LENGTH.label("distance"), ylim=(0, None))
        ax.set_xlim(time_s[0], time_s[-1])
    return drawing.panel(
        "Distance between predicted and true tip",
        f"It is {np.nanmean(distance_mm):.1f} mm on average and {np.nanmax(distance_mm):.1f} mm "
        f"at most; {int(outside.sum())} of {len(time_s)} ticks lie outside the training range.",
    )


def _between_motions(programme: Mapping[str, float], end_s: float) -> list[tuple[float, float]]:
    """Spans of the run in which the joints glide to zero or rest."""
    if not programme:
        return []
    rest_s, motion_s, _ = programme.values()
    cycle_s = sum(programme.values())
    starts_s = np.arange(-cycle_s, end_s, cycle_s) + rest_s + motion_s
    return [
        (max(start_s, 0.0), min(start_s + cycle_s - motion_s, end_s))
        for start_s in starts_s.tolist()
        if start_s < end_s
    ]


def duration_table(loop: LoopRun) -> Table:
    """Return the durations of the stages, of the whole tick and of the wake-up, with budgets."""
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
