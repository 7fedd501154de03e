"""Sections about runs of the loop: the arm, the errors of the tip, and the timing."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.core.units import FRACTION, LENGTH, PAYLOAD, TICK_TIME, TIME
from hil.report.arm import LEGEND, arm_motion, arm_panel
from hil.report.build_inputs import LoopRun
from hil.sil.sil_results import draw_ends
from hil.sil.timing_document import TimingDocument, duration_table
from hil.sil.timing_verdict import PREEMPTED_NS
from hil.verdict import Verdict
from models.predictor.validation import COVERS, coverage_text
from models.shared.drawing import Drawing, Line, log_axis, plot_lines
from models.shared.pages import (
    NO_VALUE,
    Cell,
    Figure,
    Folded,
    LegendEntry,
    Panel,
    Paragraph,
    Part,
    Table,
    TableCell,
)
from models.shared.palette import ALARM, BLUE, MUTED, ORANGE, SPAN

Array = NDArray[np.float64]

INTERVALS: Final = 240
"""Intervals of a timeline, of which each shows maximum and median."""
LEAST_MM: Final = 0.01
"""Least distance that is shown: at rest the twin is predicted exactly."""
WHOLE: Final = BLUE
OWN: Final = ORANGE
PARTS: Final = {
    "all": "all ticks", "in_range": "in range", "out_of_range": "out of range",
    "approach": "approach and probing motion", "rest": "rest between motions",
    "motion": "motion, as in training", "glide": "glide to zero after the motion",
    "stop": "controlled stop",
}  # fmt: skip


# --- the arm ------------------------------------------------------------------------------------


def arm_parts(loops: Sequence[LoopRun]) -> list[Part]:
    """The arm of one run for each number of joints: that which moves in most directions."""
    shown: dict[int | None, tuple[LoopRun, Panel]] = {}
    for loop in sorted(loops, key=lambda loop: -loop.phase_2_rad):
        if loop.dof not in shown and (motion := arm_motion(loop)):
            shown[loop.dof] = loop, arm_panel(motion, loop)
    panels = [panel for _, (_, panel) in sorted(shown.items(), key=lambda row: -(row[0] or 0))]
    if not panels:
        return []
    note = (
        "One cycle of each run, three times; then the link where it bends most. Click to play it "
        "again. The run records angles and tip; between them the link is drawn as the plant bends "
        "under a force at its tip."
    )
    return [Figure("", note, panels, legend=LEGEND)]


# --- errors of the tip --------------------------------------------------------------------------


def error_parts(loops: Sequence[LoopRun]) -> list[Part]:
    known = [loop for loop in loops if loop.timing.prediction_error.n]
    if not known:
        return []
    parts: list[Part] = [_error_table(known)]
    if drawn := [loop for loop in known if loop.true_tip_m is not None]:
        parts.append(distance_figure(drawn))
    note = (
        "During glide and rest the link still swings while the joints hardly move: angle, current "
        "and DI, which has no sign, do not show to which side it bends. The observer's bend does. "
        "Where the coverage is below 95\u00a0% the interval is too narrow."
    )
    tables = [prediction_table(loop) for loop in known]
    return [*parts, Folded("Errors by part of the run", [*tables, Paragraph(note, "note")])]


def _error_table(loops: Sequence[LoopRun]) -> Table:
    rows: list[list[Cell]] = []
    for loop in loops:
        error, rigid_off_m = loop.timing.prediction_error, loop.rigid_off_m()
        rigid = NO_VALUE if rigid_off_m is None else LENGTH.number(np.nanmean(rigid_off_m))
        measured_m = (error.mean_euclidean_distance_m, error.p95_m, error.max_m)
        rows.append([loop.title, *(LENGTH.number(value or 0.0) for value in measured_m), rigid])
    note = "Rigid link: its tip if it did not bend, at the measured angles."
    if any(loop.timing.environment.behind_the_servos == "twin" for loop in loops):
        note += (
            " Behind the servos is the twin, whose equations the robot's observer shares: on a "
            "robot the error is larger."
        )
    return Table(
        f"Distance between predicted and true tip in {LENGTH.name}",
        ["run", "mean", "95th percentile", "maximum", "rigid link, mean"], rows, note,
    )  # fmt: skip


def distance_figure(loops: Sequence[LoopRun]) -> Figure:
    """Distance of the predicted and of a rigid link's tip from the true one, over each run."""
    distances_mm = [LENGTH.shown(loop.predicted_off_m()) for loop in loops]
    all_mm = np.concatenate([d[np.isfinite(d)] for d in distances_mm])
    shown = [max(LEAST_MM, float(all_mm.min())), max(100.0, float(all_mm.max()))]
    panels = [
        _distance(loop, distance_mm, shown)
        for loop, distance_mm in zip(loops, distances_mm, strict=True)
    ]
    return Figure(
        "Distance from the true tip",
        "Median of each interval, and thin its maximum; ticks with fresh data.", panels,
        legend=[
            LegendEntry(WHOLE, "prediction"), LegendEntry(MUTED, "rigid link"),
            LegendEntry(ALARM, "at the top: inputs outside the training range", "dotted"),
            LegendEntry(SPAN, "glide and rest: not in training"),
        ],
    )  # fmt: skip


def _distance(loop: LoopRun, distance_mm: Array, shown_mm: Sequence[float]) -> Panel:
    time_s, rigid_off_m = loop.time_s(), loop.rigid_off_m()
    outside = loop.column("in_range") <= 0
    with Drawing() as (drawing, ax):
        for start_s, end_s in _between_motions(loop.timing.run.programme_s, float(time_s[-1])):
            ax.axvspan(start_s, end_s, color=SPAN, linewidth=0)
        if rigid_off_m is not None:
            plot_lines(ax, _envelope(time_s, LENGTH.shown(rigid_off_m), MUTED)[1:])
        plot_lines(ax, _envelope(time_s, distance_mm, WHOLE))
        at_the_top = ax.get_xaxis_transform()
        ax.plot(time_s[outside], np.full(outside.sum(), 0.985), "|", color=ALARM, markersize=5,
                transform=at_the_top)  # fmt: skip
        log_axis(ax, shown_mm)
        ax.set(
            xlabel=TIME.label("time"), ylabel=LENGTH.label("distance"), xlim=(0, time_s[-1]),
        )  # fmt: skip
    return drawing.panel(
        loop.title,
        f"It is {np.nanmean(distance_mm):.1f} mm on average and {np.nanmax(distance_mm):.1f} mm "
        f"at most; {int(outside.sum())} of {len(time_s)} ticks lie outside the training range.",
    )


def _envelope(time_s: Array, values: Array, colour: str) -> list[Line]:
    """Maximum and median of each interval, as a thin and a thick line."""
    groups = np.array_split(np.arange(len(time_s)), min(INTERVALS, len(time_s)))
    middle_s = [float(np.median(time_s[g])) for g in groups]
    largest = [_without_gaps(np.nanmax, values[g]) for g in groups]
    median = [_without_gaps(np.nanmedian, values[g]) for g in groups]
    return [Line(middle_s, largest, colour, width=0.6), Line(middle_s, median, colour)]


def _without_gaps(statistic: Callable[[Array], float], values: Array) -> float:
    return float(statistic(values)) if np.isfinite(values).any() else np.nan


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


def prediction_table(loop: LoopRun) -> Table:
    """Prediction error by part of the run."""
    error = loop.timing.prediction_error
    rows: list[list[Cell]] = []
    for name, part in {"all": error, **error.parts}.items():
        measured_m = (part.mean_euclidean_distance_m, part.p95_m, part.max_m)
        if distances_m := [value for value in measured_m if value is not None]:
            covered = coverage_text(part.interval_coverage or 0, part.interval_coverage_least or 0)
            in_range = FRACTION.text(part.in_range_fraction or 0.0, 1)
            distances = map(LENGTH.number, distances_m)
            rows.append([PARTS.get(name, name), str(part.n), *distances, covered, in_range])
    return Table(
        f"{loop.title}, in {LENGTH.name}",
        ["", "ticks", "mean", "95th percentile", "maximum", COVERS, "in range"],
        rows,
    )


# --- timing -------------------------------------------------------------------------------------


def timing_parts(loops: Sequence[LoopRun]) -> list[Part]:
    """Verdicts, the ends of the ticks with their deadline, and what the host did."""
    timed = [loop for loop in loops if loop.in_real_time]
    if not timed:
        only = "On the virtual line the clock is simulated, so no duration was measured."
        return [Paragraph(only)] if loops else []
    return [
        _timing_table(timed),
        *(timing_figure(loop) for loop in timed if loop.ticks is not None),
        Paragraph(
            "The end of a tick counts from the start of its slot. Own cost: without the wake-up "
            "latency and without waiting for the bus. Run queue and steal: time in which the "
            "kernel ran other processes, or the hypervisor other machines. Of that, the table "
            "counts as preemption what the measurement itself did not take.",
            "note",
        ),
        Folded("Durations of the stages", [_duration_table(loop) for loop in timed]),
        Folded("Machines and lines", [_environment_table(timed)]),
    ]


def _timing_table(loops: Sequence[LoopRun]) -> Table:
    met = {Verdict.PASS: True, Verdict.FAIL: False}
    timings = [loop.timing for loop in loops]
    own_p99 = [TICK_TIME.text(timing.own_cost.p99_ns, 2) for timing in timings]
    wake = [TICK_TIME.text(timing.lateness.p99_ns, 2) for timing in timings]
    bound = [FRACTION.text(timing.own_miss_rate_upper_bound_95, 2) for timing in timings]
    host = [
        f"{timing.host.preempted_ticks} ticks, {TICK_TIME.text(timing.host.max_ns, 1)} at most"
        for timing in timings
    ]
    rows: list[list[Cell]] = [
        ["verdict", *(TableCell(str(t.verdict), met.get(t.verdict)) for t in timings)],
        ["reason", *(t.reason for t in timings)],
        ["deadlines missed", *(_missed(t) for t in timings)],
        ["missed by the loop itself", *(str(t.own_misses) for t in timings)],
        ["the same at most, with 95\u00a0% confidence", *bound],
        ["own cost of a tick, p99", *own_p99],
        ["wake-up latency, p99", *wake],
        ["preempted by the host", *host],
    ]
    return Table("", ["", *(loop.title for loop in loops)], rows)


def _missed(timing: TimingDocument) -> str:
    causes = [f"{count} {cause.value}" for cause, count in timing.causes.items() if count]
    missed = f"{timing.misses} of {timing.slots}"
    if not causes:
        return missed
    return f"{missed} ({', '.join(causes)}; {timing.longest_run_of_misses} in a row at most)"


def timing_figure(loop: LoopRun) -> Figure:
    """Histogram of the ticks with their deadline, and the run over time with the host's part."""
    deadline_ms = float(TICK_TIME.shown(loop.timing.targets.period_ns))
    busy_ns = loop.column("busy_ns")
    end_ms = TICK_TIME.shown(loop.column("lateness_ns") + busy_ns)
    own_ms = TICK_TIME.shown(busy_ns - loop.column("bus_wait_ns"))
    host_ms = TICK_TIME.shown(loop.column("preempted_ns") + loop.column("steal_ns"))
    panels = [
        _histogram(end_ms, own_ms, deadline_ms),
        _timeline(loop.time_s(), end_ms, host_ms, deadline_ms),
    ]
    return Figure(
        loop.title,
        "",
        panels,
        legend=[
            LegendEntry(WHOLE, "end of a tick in its slot"),
            LegendEntry(OWN, "own cost of a tick"),
            LegendEntry(MUTED, "run queue and steal, 0.5 ms or more"),
            LegendEntry(ALARM, f"deadline, {deadline_ms:g} ms", "dashed"),
        ],
    )


def _histogram(end_ms: Array, own_ms: Array, deadline_ms: float) -> Panel:
    with Drawing() as (drawing, ax):
        draw_ends(ax, end_ms, own_ms, deadline_ms, TICK_TIME)
    return drawing.panel(
        "Latency histogram",
        f"Ends of {len(end_ms)} ticks: {np.median(end_ms):.2f} ms in the median and "
        f"{end_ms.max():.2f} ms at most; own cost {own_ms.max():.2f} ms at most; the deadline is "
        f"at {deadline_ms:g} ms.",
    )


def _timeline(time_s: Array, end_ms: Array, host_ms: Array, deadline_ms: float) -> Panel:
    preempted = host_ms >= TICK_TIME.shown(PREEMPTED_NS)
    missed = end_ms > deadline_ms
    with Drawing() as (drawing, ax):
        ax.vlines(time_s[preempted], 0.0, host_ms[preempted], color=MUTED, linewidth=2)
        plot_lines(ax, _envelope(time_s, end_ms, WHOLE))
        ax.plot(time_s[missed], np.full(missed.sum(), deadline_ms), "v", color=ALARM, markersize=4)
        ax.axhline(deadline_ms, color=ALARM, linestyle="--", linewidth=1)
        ax.set(
            xlabel=TIME.label("time"), ylabel=TICK_TIME.label("end of a tick"),
            xlim=(0, time_s[-1]), ylim=(0, 1.12 * deadline_ms), yticks=[0, 5, 10, deadline_ms],
        )  # fmt: skip
    return drawing.panel(
        "Over the run: median of each interval, and thin its maximum",
        f"Ends of the ticks over {time_s[-1]:.0f} s; the host took up to {host_ms.max():.1f} ms "
        f"of one, and {int(missed.sum())} ticks cross the line at {deadline_ms:g} ms.",
    )


def _duration_table(loop: LoopRun) -> Table:
    header, *rows = duration_table(loop.timing, TICK_TIME)
    return Table(f"{loop.title}, in {TICK_TIME.name}", header, [list[Cell](row) for row in rows])


def _environment_table(loops: Sequence[LoopRun]) -> Table:
    of_loops = [_environment(loop) for loop in loops]
    names = dict.fromkeys(name for facts in of_loops for name in facts)
    rows = [[name, *(facts.get(name, NO_VALUE) for facts in of_loops)] for name in names]
    return Table("", ["", *(loop.title for loop in loops)], rows)


def _environment(loop: LoopRun) -> dict[str, str]:
    """Environment of a run in display units."""
    environment = loop.timing.environment
    units = {"_ns": TICK_TIME, "_kg": PAYLOAD}
    facts = {}
    for name, value in msgspec.structs.asdict(environment).items():
        if value in ({}, (), None, "") or (name == "load_is" and not environment.load_processes):
            continue
        if isinstance(value, dict):
            text = ", ".join(f"{key} {number:g}" for key, number in value.items())
        else:
            text = f"{value:.4g}" if isinstance(value, float) else str(value)
        for suffix, unit in units.items():
            if name.endswith(suffix):
                name, text = name.removesuffix(suffix), unit.significant(value)
        facts[name.replace("_", " ")] = text
    return facts
