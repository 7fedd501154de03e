"""Picture of a run in software: error of the predicted tip, and when the ticks ended."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from firmware_py.core.units import LENGTH, TICK_TIME, TIME
from hil.sil.prediction_error import predicted_tip_m, true_tip_m
from hil.sil.sil_loop import SilResult
from hil.sil.timing_verdict import TimingVerdict
from models.shared.drawing import FILE_STYLE
from models.shared.palette import ALARM, MUTED, SERIES


def draw_summary(result: SilResult, timing: TimingVerdict, path: Path) -> None:
    with mpl.rc_context(FILE_STYLE | {"font.size": 8}):
        figure = Figure(figsize=(8, 5), layout="constrained")
        error, ends = figure.subplots(2)
        _draw_error(error, result)
        _draw_ends(ends, result, timing)
        figure.suptitle(f"{timing.verdict}: {timing.reason}")
        figure.savefig(path, metadata={"Date": None})


def _draw_error(axes: Axes, result: SilResult) -> None:
    """Distance of the predicted tip from the true one over time."""
    records = result.records
    off_m = predicted_tip_m(records) - true_tip_m(records, result.outcome.truth)
    if not np.isfinite(off_m).any():
        axes.set_axis_off()
        axes.text(0.5, 0.5, "no true tip to compare with", ha="center")
        return
    distance_mm = LENGTH.shown(np.linalg.norm(off_m, axis=1))
    axes.plot(records["time_s"], distance_mm, color=SERIES[0], label="predicted − true tip")
    axes.axhline(float(np.nanmean(distance_mm)), color=MUTED, ls="--", label="mean")
    axes.set(xlabel=TIME.label("time"), ylabel=LENGTH.label("distance"), ylim=(0, None))
    axes.legend(ncols=2)


def _draw_ends(axes: Axes, result: SilResult, timing: TimingVerdict) -> None:
    """Histogram of the ends of the ticks in their slots, with the deadline in it."""
    records = result.records
    end_ms = TICK_TIME.shown(records["lateness_ns"] + records["busy_ns"])
    own_ms = TICK_TIME.shown(records["busy_ns"] - records["bus_wait_ns"])
    deadline_ms = float(TICK_TIME.shown(timing.budget.period_ns))
    least_ms = max(float(np.min(own_ms)), 1e-3)
    edges = np.geomspace(least_ms, 1.2 * max(deadline_ms, float(np.max(end_ms))), 80).tolist()
    axes.hist(own_ms, edges, color=SERIES[1], alpha=0.7, label="own cost of a tick")
    axes.hist(end_ms, edges, color=SERIES[0], alpha=0.7, label="end of a tick in its slot")
    axes.axvline(deadline_ms, color=ALARM, ls="--", label="deadline")
    if timing.host.preempted_ticks:
        axes.plot([], [], " ", label=f"the host preempted {timing.host.preempted_ticks} ticks")
    axes.set(xlabel=TICK_TIME.label("time"), ylabel="ticks", xscale="log", yscale="log")
    axes.legend(loc="upper center")
