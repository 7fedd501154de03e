"""Picture of a run in software: true and predicted tip, duration of each tick, histogram."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

from firmware_py.display_units import POSITION, TICK_TIME, TIME
from hil.sil.prediction_error import predicted_tip_m, true_tip_m
from hil.sil.sil_loop import SilResult
from hil.timing.timing_verdict import TimingVerdict
from models.shared.drawing import FILE_STYLE
from models.shared.palette import ALARM, SERIES


def draw_summary(result: SilResult, timing: TimingVerdict, path: Path) -> None:
    records, truth = result.records, true_tip_m(result.records, result.outcome.truth)
    time_s, predicted = records["time_s"], predicted_tip_m(records)
    busy_ms = TICK_TIME.shown(records["lateness_ns"] + records["busy_ns"])
    own_ms = TICK_TIME.shown(records["busy_ns"] - records["bus_wait_ns"])
    period_ms = float(TICK_TIME.shown(timing.budget.period_ns))
    with mpl.rc_context(FILE_STYLE | {"font.size": 8}):
        figure = Figure(figsize=(8, 6), layout="constrained")
        tip, ticks, histogram = figure.subplots(3)
        for k, axis in enumerate("xyz"):
            tip.plot(time_s, truth[:, k], color=SERIES[k], label=f"{axis} true")
            tip.plot(time_s, predicted[:, k], color=SERIES[k], ls=":", label=f"{axis} predicted")
        tip.set(xlabel=TIME.label("time"), ylabel=POSITION.label("tip"))
        tip.legend(ncols=3, loc="lower right", fontsize="x-small")
        ticks.plot(
            time_s, busy_ms, ".", ms=2, rasterized=True, label="end of tick behind its deadline"
        )
        ticks.plot(time_s, own_ms, ".", ms=2, rasterized=True, label="own cost")
        ticks.axhline(period_ms, color=ALARM, ls="--", label="period")
        ticks.set(xlabel=TIME.label("time"), ylabel=TICK_TIME.label("duration"), yscale="log")
        ticks.legend(ncols=3)
        histogram.hist([busy_ms, own_ms], bins=80, log=True, label=["end of tick", "own cost"])
        histogram.axvline(period_ms, color=ALARM, ls="--")
        histogram.set(xlabel=TICK_TIME.label("duration"), ylabel="ticks")
        histogram.legend()
        figure.suptitle(f"{timing.verdict}: {timing.reason}")
        figure.savefig(path, metadata={"Date": None})
