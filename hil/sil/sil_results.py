"""Results of a run in software: everything measured, timing document, trial and picture."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.bus.bus_plan import Plan
from firmware_py.core.errors import InputError
from firmware_py.core.signals import joint_signals, marker_signals, tip_names
from firmware_py.core.units import CPU_TIME, LENGTH, POSITION, TIME, DisplayUnit
from firmware_py.goals.plan_goals import payload_beyond_plan
from firmware_py.link.marker_layout import MarkerLayout
from firmware_py.log.recording import OUTSIDE
from firmware_py.safety.states import SafetyState
from firmware_py.summary import Ended, RangeReasons, RunSummary
from hil.emulator.emulator import EmulatorOutcome
from hil.sil.probe import ProbeRecord
from hil.sil.sil_options import SilOptions
from hil.sil.tick_budget import plan_times, read_parts
from hil.sil.timing_document import (
    MoveFigures,
    PathError,
    PredictionError,
    RunFacts,
    SilEnvironment,
    TimingDocument,
    duration_table,
    write_timing,
)
from hil.sil.timing_verdict import judge_timing, timing_junit
from hil.sil.tip_errors import (
    move_figures,
    path_errors,
    predicted_tip_m,
    prediction_error,
    tip_of_runs_m,
    true_tip_m,
)
from models.predictor.validation import coverage_text
from models.shared.palette import ALARM, BLUE, MUTED, ORANGE
from models.trials.files import write_trial
from models.trials.trial import Trial, TrialMeta, rows_at_rest

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False, eq=False)
class SilResult:
    """Result of `run_sil`: the loop's summary and everything measured during the run.

    Attributes
    ----------
    options : SilOptions
        Options of the run.
    summary : RunSummary
        The loop's own summary.
    outcome : EmulatorOutcome
        The emulator's record: true tip, release times, injected faults.
    loop_cpu, line_cpu : ProbeRecord
        Wake-up jitter probes on the processors of loop and emulator; empty on the virtual line.
    wall_s : float
        Wall-clock time of the run.
    environment : SilEnvironment
        Machine, scheduler, load and line.
    bus_plan : Plan
        Plan by which the servos were read.
    out_of_range : RangeReasons
        Why ticks were out of the predictor's range.
    link : dict of str to Any, optional
        Trial conditions that follow from the link: size, pressure, markers, gravity; empty if the
        plant does not describe a link.

    Examples
    --------
    >>> import dropstitch
    >>> bundle = "docs/notebooks/bundle_1dof"
    >>> run = dropstitch.run_sil(bundle, line="virtual", seconds=2.0)
    >>> run.timing.own_misses, run.trial().meta.source
    (0, 'sil')
    """

    options: SilOptions
    summary: RunSummary
    outcome: EmulatorOutcome
    loop_cpu: ProbeRecord
    line_cpu: ProbeRecord
    wall_s: float
    environment: SilEnvironment
    bus_plan: Plan
    out_of_range: RangeReasons
    link: dict[str, Any] | None = None

    def __repr__(self) -> str:
        timing, error = self.timing, self.timing.prediction_error
        tip = ""
        if error.mean_euclidean_distance_m is not None:
            distance_mm = LENGTH.number(error.mean_euclidean_distance_m)
            tip = f", predicted tip off by {distance_mm} mm on average"
        return (
            f"<SilResult: {timing.verdict}, {timing.ticks} ticks on the {self.options.line} line, "
            f"{timing.own_misses} own misses{tip}>"
        )

    @property
    def records(self) -> NDArray[np.void]:
        """Every tick of the run, in order, with the fields of `tick_dtype`."""
        return self.summary.records

    @cached_property
    def timing(self) -> TimingDocument:
        """Verdict and measurements, the content of `timing.json`."""
        return _timing_document(self)

    def text(self) -> str:
        """Return the verdict and the main figures as text."""
        return timing_in_words(self.timing)

    def plot(self) -> Figure:
        """Draw the error of the predicted tip, and when the ticks ended in their slots."""
        return _plot(self)

    def trial(self) -> Trial:
        """Return the run as a trial: the servos' measurements and the true tip.

        Raises
        ------
        InputError
            If the run ended before its motion.
        """
        return _trial_of(self)

    def write(self, out: Path | str | None = None) -> Path:
        """Write timing.json, timing.xml, trial and summary.svg; return the directory.

        Parameters
        ----------
        out : Path or str, optional
            Directory; by default that of the run, which holds the log.
        """
        from models.shared.drawing import save_svg  # loads matplotlib

        directory = self.options.out if out is None else Path(out)
        directory.mkdir(parents=True, exist_ok=True)
        timing = self.timing
        write_timing(directory / "timing.json", timing)
        facts = msgspec.to_builtins(timing.environment)
        (directory / "timing.xml").write_bytes(timing_junit(timing, facts))
        if self.link and _measured_in_motion(self).sum() > 1:
            write_trial(self.trial(), directory / "trial")
        save_svg(self.plot(), directory / "summary.svg")
        return directory


def _timing_document(result: SilResult) -> TimingDocument:
    """Judge a run and return the contents of `timing.json`."""
    options, summary, records = result.options, result.summary, result.records
    truth, plan = result.outcome.truth, options.plan
    verdict = judge_timing(
        records,
        options.period_s,
        result.loop_cpu,
        result.line_cpu,
        result.outcome.releases,
        stopped=summary.reason if summary.ended is Ended.TRIPPED else "",
        faults=summary.faults,
        interrupted=_interrupted(result),
        miss_rate=1.0 if options.line == "virtual" else options.miss_rate,
    )
    bus_times = plan_times(result.bus_plan)
    errors: tuple[PathError, ...] = ()
    moves: tuple[MoveFigures, ...] = ()
    payload_note = ""
    if plan is not None:
        runs_m = tip_of_runs_m(records, truth, plan)
        errors = path_errors(runs_m, plan)
        moves = move_figures(runs_m[-1], plan) if len(runs_m) else ()
        known_kg = options.payload_kg if options.payload_known else None
        payload_note = payload_beyond_plan(plan, known_kg, summary)
    return TimingDocument(
        **msgspec.structs.asdict(verdict),
        environment=result.environment,
        run=RunFacts(
            ended=summary.ended.value,
            reason=summary.reason,
            wall_s=result.wall_s,
            bus_faults=summary.bus_faults,
            faults_injected=result.outcome.faults,
            telemetry_drops=summary.telemetry_drops,
            programme_s=options.programme_s,
            feedback=summary.feedback,
            payload_note=payload_note,
            out_of_range=summary.out_of_range,
            out_of_range_reasons=result.out_of_range,
        ),
        reference_jitter=result.loop_cpu.jitter(),
        bus_plan=bus_times,
        read_parts=read_parts(records, bus_times),
        prediction_error=prediction_error(records, truth, options.programme_s),
        path_errors=errors,
        moves=moves,
    )


def _interrupted(result: SilResult) -> str:
    """Sentence on a signal that ended the run early, with the slots completed by then; or ""."""
    summary = result.summary
    if summary.ended is not Ended.SIGNALLED:
        return ""
    in_motion = result.records["state"] < SafetyState.STOPPING
    ran = max(int(result.records["tick"][in_motion].max(initial=-1)) + 1, 0)
    return f"{summary.reason} ended the run after {ran} of {result.options.slots} slots"


def _measured_in_motion(result: SilResult) -> NDArray[np.bool_]:
    """Ticks of the motion with fresh data, shape (n,)."""
    tip = true_tip_m(result.records, result.outcome.truth)
    return np.asarray(np.isfinite(tip[:, 0]) & (result.records["tick"] >= 0))


def _trial_of(result: SilResult) -> Trial:
    """Return the run as a trial, from the beginning of its motion.

    Approach and probing motion precede it: the first rows of a trial are at rest. The emulator has
    no markers, so their cells stay empty. A trial has a uniform time step, so skipped slots and
    ticks without fresh data are interpolated; the notes count them.
    """
    options, records = result.options, result.records
    measured = int(_measured_in_motion(result).sum())
    if measured < 2:
        raise InputError("run", "ended before its motion", "see its reason, and run it again")
    tip = true_tip_m(records, result.outcome.truth)
    fresh = np.isfinite(tip[:, 0])
    grid = np.arange(records["tick"][-1] + 1)
    columns = {"time_s": grid * options.period_s}
    known = {s.name: records[s.name] for s in joint_signals(options.dof)}
    known |= {name: tip[:, k] for k, name in enumerate(tip_names())}
    for name, values in known.items():
        columns[name] = np.interp(grid, records["tick"][fresh], values[fresh])
    filled = len(grid) - measured
    rest_s, link = options.motion.rest_s, result.link or {}
    if options.plan is not None:
        conditions: dict[str, Any] = options.plan.conditions()
        rest_s = options.plan.rest_s
    elif options.goals is not None:
        goals = np.column_stack([columns[f"goal_{j}_rad"] for j in range(1, options.dof + 1)])
        rest_s = rows_at_rest(goals) * options.period_s
        conditions = {
            "motion": OUTSIDE,
            "period_s": max(len(goals) * options.period_s - rest_s, options.period_s),
            "amplitude_rad": float(np.abs(goals).max()),
        }
    else:
        motion = options.motion.motion(options.dof)
        conditions = {
            "motion": motion.kind,
            "period_s": motion.period_s,
            "amplitude_rad": motion.amplitude_rad,
            "phase_2_rad": motion.phase_2_rad if options.dof == 2 else 0.0,
        }
    meta = TrialMeta(
        dof=options.dof,
        payload_kg=options.payload_kg,
        trial=1,
        source="sil",
        **conditions,
        rest_samples=min(max(round(rest_s / options.period_s), 1), len(grid) - 1),
        notes=f"{filled} of {len(grid)} rows interpolated" if filled else "",
        **{key: value for key, value in link.items() if key != "markers"},
        markers=msgspec.convert(link["markers"], MarkerLayout) if "markers" in link else None,
    )
    for signal in marker_signals(meta.layout.count):
        columns[signal.name] = np.full(len(grid), np.nan)
    return Trial("sil", meta, columns)


def _plot(result: SilResult) -> Figure:
    from matplotlib import pyplot

    from models.shared.drawing import FILE_STYLE

    records, timing = result.records, result.timing
    with pyplot.rc_context(FILE_STYLE | {"font.size": 8}):
        figure: Figure = pyplot.figure(figsize=(8, 5), layout="constrained")
        error, ends = figure.subplots(2)
        _draw_error(error, result)
        end_s = 1e-9 * (records["lateness_ns"] + records["busy_ns"])
        own_s = 1e-9 * (records["busy_ns"] - records["bus_wait_ns"])
        draw_ends(ends, end_s, own_s, 1e-9 * timing.targets.period_ns, TIME)
        if timing.host.preempted_ticks:
            ends.plot([], [], " ", label=f"the host preempted {timing.host.preempted_ticks} ticks")
        ends.legend(loc="upper center")
        figure.suptitle(f"{timing.verdict}: {timing.reason}")
        pyplot.close(figure)
    return figure


def _draw_error(axes: Axes, result: SilResult) -> None:
    """Distance of the predicted tip from the true one over time."""
    records = result.records
    off_m = predicted_tip_m(records) - true_tip_m(records, result.outcome.truth)
    if not np.isfinite(off_m).any():
        axes.set_axis_off()
        axes.text(0.5, 0.5, "no true tip to compare with", ha="center")
        return
    distance_m = np.linalg.norm(off_m, axis=1)
    axes.plot(records["time_s"], distance_m, color=BLUE, label="predicted − true tip")
    axes.axhline(float(np.nanmean(distance_m)), color=MUTED, ls="--", label="mean")
    axes.set(xlabel=TIME.label("time"), ylabel=POSITION.label("distance"), ylim=(0, None))
    axes.legend(ncols=2)


def draw_ends(
    axes: Axes, end: NDArray[Any], own: NDArray[Any], deadline: float, unit: DisplayUnit
) -> None:
    """Histograms of the ends of the ticks in their slots and of their own cost, all in `unit`."""
    from models.shared.drawing import log_axis

    least = max(float(np.min(own)), 1e-4 * deadline)
    most = 1.2 * max(deadline, float(np.max(end)))
    edges = np.geomspace(least, most, 60).tolist()
    axes.hist(own, edges, color=ORANGE, alpha=0.7, label="own cost of a tick")
    axes.hist(end, edges, color=BLUE, alpha=0.7, label="end of a tick in its slot")
    axes.axvline(deadline, color=ALARM, linestyle="--", linewidth=1, label="deadline")
    log_axis(axes, [least, most], "x")
    log_axis(axes, [1.0, len(end)])
    axes.set(xlabel=unit.label("time"), ylabel="ticks")


def timing_in_words(timing: TimingDocument) -> str:
    """Verdict and main figures of a run, as text."""
    environment = timing.environment
    lines = [
        f"{timing.verdict}: {timing.reason}",
        f"{timing.run.ended}: {timing.run.reason}; {timing.ticks} ticks in "
        f"{timing.run.wall_s:.1f} s on the {environment.line} line",
    ]
    if environment.speed_up is not None:
        lines.append(
            f"{environment.speed_up:.3g} times real time, "
            f"{environment.speed_up_by_processor_time:.3g} times by processor time"
        )
    else:
        lines += _timing_lines(timing)
    if environment.goals_note:
        lines.append(environment.goals_note)
    lines += filter(None, (timing.run.feedback.note, timing.run.payload_note))
    if timing.run.out_of_range:
        outside = f"{timing.run.out_of_range} ticks out of the predictor's range"
        lines.append(": ".join(filter(None, (outside, timing.run.out_of_range_reasons.note))))
    lines += _error_lines(timing.prediction_error)
    lines += [
        f"tip off its path in run {number} of the plan by {LENGTH.number(error.rms_m, 2)} mm RMS, "
        f"{LENGTH.number(error.max_m)} mm at most; {LENGTH.number(error.path_rms_m, 2)} mm RMS "
        "on the path alone"
        for number, error in enumerate(timing.path_errors, start=1)
    ]
    lines += [
        f"move {number}: {TIME.number(move.command_s, 2)} s, settled within 10 mm after "
        f"{TIME.number(move.settling_s, 2)} s, swing {LENGTH.number(move.swing_m, 1)} mm, at rest "
        f"{LENGTH.number(move.offset_m, 1)} mm beside its place"
        for number, move in enumerate(timing.moves, start=1)
    ]
    return "\n".join(lines)


def _timing_lines(timing: TimingDocument) -> list[str]:
    causes = ", ".join(f"{count} {cause.value}" for cause, count in timing.causes.items())
    table = duration_table(timing, CPU_TIME)
    table[0][0] = f"in {CPU_TIME.name}"
    return [
        f"misses {timing.misses} ({causes}); the host preempted {timing.host.preempted_ticks} of "
        f"{timing.ticks} ticks",
        *(
            f"{name:32} " + " ".join(f"{cell:>8}" for cell in cells) + f" {budget:>14}".rstrip()
            for name, *cells, budget in table
        ),
        *timing.environment.refused,
    ]


def _error_lines(error: PredictionError) -> list[str]:
    if error.mean_euclidean_distance_m is None or error.max_m is None:
        return []
    return [
        f"predicted tip off by {LENGTH.number(error.mean_euclidean_distance_m)} mm on average, "
        f"{LENGTH.number(error.max_m)} mm at most",
        *(
            f"  {name.replace('_', ' '):12} "
            f"{LENGTH.number(part.mean_euclidean_distance_m or 0):>5} mm, "
            f"{LENGTH.number(part.max_m or 0):>5} mm at most, interval covers "
            f"{coverage_text(part.interval_coverage or 0, part.interval_coverage_least or 0)} %"
            for name, part in error.parts.items()
        ),
    ]
