"""Where the time of the ticks went: timeline and histogram, with the 17 ms line."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hil.report.inputs import Loop
from hil.report.svg import ALARM, Drawing, Figure, Panel

MS: Final = 1e-6
"""Milliseconds in a nanosecond."""
BINS: Final = 240
WHOLE: Final = "#1d6a96"
OWN: Final = "#b4532a"


def loop_figures(loop: Loop) -> Figure | None:
    """Timeline and histogram of a run; None where it kept no ticks."""
    if loop.ticks is None:
        return None
    ticks, period_ms = loop.ticks, loop.timing["budget"]["period_ns"] * MS
    time_s = ticks["time_s"]
    whole_ms = (ticks["lateness_ns"] + ticks["busy_ns"]) * MS
    own_ms = (ticks["busy_ns"] - ticks["bus_wait_ns"]) * MS
    missed = whole_ms > period_ms
    timeline = _timeline(time_s, whole_ms, own_ms, missed, period_ms)
    histogram = _histogram(whole_ms, own_ms, period_ms)
    environment = loop.timing["environment"]
    line = environment.get("line", "unknown line")
    return Figure(
        f"Ticks on the {line} line",
        "Whole tick: from the deadline to the end of the tick. Own cost: without wake-up and "
        "without waiting for the wire.",
        [timeline, histogram],
        legend=[
            (WHOLE, "whole tick", "solid"),
            (OWN, "own cost", "solid"),
            (ALARM, f"period, {period_ms:g} ms", "dashed"),
        ],
    )


def _timeline(
    time_s: NDArray[np.float64],
    whole_ms: NDArray[np.float64],
    own_ms: NDArray[np.float64],
    missed: NDArray[np.bool_],
    period_ms: float,
) -> Panel:
    """Per bin of time the slowest tick and the median one: no outlier is lost by thinning."""
    groups = np.array_split(np.arange(len(time_s)), min(BINS, len(time_s)))
    middle_s = [float(np.median(time_s[g])) for g in groups]
    with Drawing() as (drawing, ax):
        for values, colour in ((whole_ms, WHOLE), (own_ms, OWN)):
            low, centre, high = (
                [float(f(values[g])) for g in groups] for f in (np.min, np.median, np.max)
            )
            ax.fill_between(middle_s, low, high, color=colour, alpha=0.25, linewidth=0, step="mid")
            ax.plot(middle_s, centre, color=colour, linewidth=0.9)
        ax.plot(time_s[missed], np.full(missed.sum(), period_ms), "v", color=ALARM, markersize=4)
        ax.axhline(period_ms, color=ALARM, linestyle="--", linewidth=1)
        ax.set(xlabel="time in s", ylabel="duration in ms", ylim=(0, 1.12 * period_ms))
    return drawing.panel(
        "Timeline",
        f"Duration of {len(time_s)} ticks over {time_s[-1] - time_s[0]:.0f} s: the whole tick is "
        f"{np.median(whole_ms):.2f} ms in the median and {whole_ms.max():.2f} ms at most, the own "
        f"cost {own_ms.max():.2f} ms at most; {int(missed.sum())} ticks cross the line at "
        f"{period_ms:g} ms.",
    )


def _histogram(
    whole_ms: NDArray[np.float64],
    own_ms: NDArray[np.float64],
    period_ms: float,
) -> Any:
    edges = np.linspace(0, 1.12 * period_ms, 96)
    with Drawing() as (drawing, ax):
        for values, colour in ((whole_ms, WHOLE), (own_ms, OWN)):
            counts, _ = np.histogram(np.minimum(values, edges[-1]), edges)
            ax.stairs(counts, edges, fill=True, color=colour, alpha=0.3)
            ax.stairs(counts, edges, color=colour, linewidth=1)
        ax.axvline(period_ms, color=ALARM, linestyle="--", linewidth=1)
        ax.set(xlabel="duration in ms", ylabel="ticks", yscale="log", xlim=(0, edges[-1]))
        ax.set_ylim(0.7, None)
        ax.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        ax.yaxis.set_minor_formatter(lambda value, _: "")
    return drawing.panel(
        "Histogram",
        f"Histogram of {len(whole_ms)} ticks: 99 % of the whole ticks last at most "
        f"{np.percentile(whole_ms, 99):.2f} ms, 99 % of the own cost at most "
        f"{np.percentile(own_ms, 99):.2f} ms, against a period of {period_ms:g} ms.",
    )


def stages(loop: Loop) -> list[tuple[str, list[str]]]:
    """Rows of the stage table: name, then n, p50, p99, p99.9 and maximum in ms."""
    timing = loop.timing
    rows = {f"stage: {name}": summary for name, summary in timing["stages"].items()}
    rows |= {
        "whole tick": timing["tick"],
        "waiting for the wire": timing["bus_wait"],
        "own cost": timing["own_cost"],
        "lateness of the wake-up": timing["lateness"],
        "reference jitter beside it": timing["reference_jitter"],
    }
    columns = ("p50_ns", "p99_ns", "p99_9_ns", "max_ns")
    return [
        (name, [str(s["n"]), *(f"{s[column] * MS:.3f}" for column in columns)])
        for name, s in rows.items()
    ]
