"""What a run in software leaves behind: truth beside prediction, and the run as a trial again."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from firmware_py.display_units import POSITION, TICK_TIME, TIME
from firmware_py.motion import GLIDE_S, Motion
from firmware_py.safety.states import SafetyState
from firmware_py.signals import joint_signals, tip_names
from hil.emulator.emulator import Truth
from hil.sil import SilOptions, SilResult
from models.shared.palette import ALARM, SERIES
from models.shared.svg_drawing import FILE_STYLE
from models.trials.trial import Trial, TrialMeta

Array = NDArray[np.float64]
PRESSURE_PA: Final = 41_300.0
"""Pressure that the plant's parameters stand for (docs/sources.md, "The link")."""
_FIGURES: Final = (
    "mean_euclidean_distance_m", "rms_m", "p95_m", "max_m", "interval_coverage", "in_range_share",
)  # fmt: skip
_MARKERS = tuple(f"m{i:02d}_{axis}_m" for i in range(1, 17) for axis in "xyz")


def true_tip_m(records: NDArray[np.void], truth: Truth) -> Array:
    """Tip at the moment that each tick measured, the second time where it read twice, shape (n, 3).

    NaN where no servo was asked or the answer is older than the tick: there the robot had no
    fresh measurement to predict from.
    """
    tip = np.full((len(records), 3), np.nan)
    if len(truth.time_ns) == 0:
        return tip
    wake_ns = records["deadline_ns"] + records["lateness_ns"]
    sample = np.searchsorted(truth.time_ns, wake_ns + records["busy_ns"], side="right") - 1
    inside = (sample >= 0) & (truth.time_ns[sample] >= wake_ns) & (records["stale_ticks"] == 0)
    tip[inside] = truth.tip_m[sample[inside]]
    return tip


def predicted_tip_m(records: NDArray[np.void]) -> Array:
    """The robot's own prediction, shape (n, 3)."""
    return np.column_stack([records[name] for name in tip_names("predicted_")])


def programme_s(options: SilOptions) -> dict[str, float]:
    """Durations of what the run repeats, in order: rest, motion, glide back to zero."""
    m = options.motion
    motion = Motion(m.kind, m.amplitude_rad, m.period_s, m.phase_2_rad, options.dof)
    parts_s = {"rest": m.rest_s, "motion": motion.duration_s, "glide": GLIDE_S}
    period_s = options.period_s  # the loop runs whole slots
    return {name: round(part_s / period_s) * period_s for name, part_s in parts_s.items()}


def programme_part(time_s: Array, programme: Mapping[str, float]) -> NDArray[np.str_]:
    """Part of the programme that each time falls into, shape (n,)."""
    ends_s = np.cumsum(list(programme.values()))
    # Half a microsecond: a slot's time is its number times the period, rounded.
    part = np.searchsorted(ends_s, np.mod(time_s + 5e-7, ends_s[-1]), side="right")
    return np.array([list(programme)[k] for k in part])


def prediction_error(
    records: NDArray[np.void], truth: Truth, programme: Mapping[str, float] | None = None
) -> dict[str, Any]:
    """Distance between the robot's prediction and the plant's tip over all fresh ticks.

    Parameters
    ----------
    records : ndarray
        Every tick.
    truth : Truth
        Of the plant.
    programme : mapping of str to float, optional
        As `programme_s` gives it: the error by its parts is added, the controlled stop apart.

    Returns
    -------
    dict
        n, mean_euclidean_distance_m, rms_m, p95_m, max_m; interval_coverage is the share of
        coordinates inside the predictor's 95 % interval, in_range_share that of ticks inside its
        training range. Figures are None where there was no fresh tick. `parts` has the same for
        in_range, out_of_range and each part of the programme that has fresh ticks.
    """
    error = predicted_tip_m(records) - true_tip_m(records, truth)
    fresh = np.asarray(np.isfinite(error).all(axis=1))
    inside = np.abs(error) <= np.column_stack([records[f"half_width_{axis}_m"] for axis in "xyz"])
    in_range = records["in_range"].astype(bool)

    def figures(rows: NDArray[np.bool_]) -> dict[str, Any]:
        if not rows.any():
            return {"n": 0, **dict.fromkeys(_FIGURES)}
        distance = np.linalg.norm(error[rows], axis=1)
        values = (
            distance.mean(),
            np.sqrt(np.mean(distance**2)),
            np.quantile(distance, 0.95),
            distance.max(),
            inside[rows].mean(),
            in_range[rows].mean(),
        )
        return {"n": int(rows.sum())} | dict(zip(_FIGURES, map(float, values), strict=True))

    parts: dict[str, NDArray[np.bool_]] = {"in_range": in_range, "out_of_range": ~in_range}
    if programme:
        stopping = records["state"] >= SafetyState.STOPPING
        part = programme_part(records["time_s"], programme)
        parts |= {n: np.asarray(part == n) & ~stopping for n in programme} | {"stop": stopping}
    by_part = {name: figures(fresh & rows) for name, rows in parts.items()}
    return figures(fresh) | {"parts": {name: part for name, part in by_part.items() if part["n"]}}


def as_trial(result: SilResult, options: SilOptions) -> Trial:
    """The run as a trial: what the servos measured beside where the tip truly was.

    The emulator has no markers: their cells stay empty. Slots that were skipped and ticks without
    fresh data are interpolated, and the notes count them, since a trial has a uniform time step.

    Parameters
    ----------
    result : SilResult
        The run.
    options : SilOptions
        What was run; its plant must be a link.
    """
    records = result.records
    tip = true_tip_m(records, result.outcome.truth)
    fresh = np.isfinite(tip[:, 0])
    grid = np.arange(records["tick"][0], records["tick"][-1] + 1)
    columns = {"time_s": (grid - grid[0]) * options.period_s}
    known = {s.name: records[s.name] for s in joint_signals(options.dof)}
    known |= {name: tip[:, k] for k, name in enumerate(tip_names())}
    for name, values in known.items():
        columns[name] = np.interp(grid, records["tick"][fresh], values[fresh])
    columns |= {name: np.full(len(grid), np.nan) for name in _MARKERS}
    geometry = result.geometry or {}
    motion, filled = options.motion, len(grid) - int(fresh.sum())
    meta = TrialMeta(
        dof=options.dof,
        payload_kg=options.payload_kg,
        pressure_pa=PRESSURE_PA,
        trial=1,
        motion=motion.kind,
        source="sil",
        period_s=motion.period_s,
        amplitude_rad=motion.amplitude_rad,
        phase_2_rad=motion.phase_2_rad if options.dof == 2 else 0.0,
        rest_samples=round(motion.rest_s / options.period_s),
        notes=f"{filled} of {len(grid)} rows interpolated" if filled else "",
        base_offset_m=geometry["base_offset_m"],
        link_length_m=geometry["link_length_m"],
        link_width_m=geometry["link_width_m"],
    )
    return Trial("sil", meta, columns)


def draw_summary(result: SilResult, timing: dict[str, Any], path: Path) -> None:
    """A small picture of the run: tip and prediction, tick by tick timing, histogram."""
    records, truth = result.records, true_tip_m(result.records, result.outcome.truth)
    time_s, predicted = records["time_s"], predicted_tip_m(records)
    busy_ms = TICK_TIME.shown(records["lateness_ns"] + records["busy_ns"])
    own_ms = TICK_TIME.shown(records["busy_ns"] - records["bus_wait_ns"])
    period_ms = float(TICK_TIME.shown(timing["budget"]["period_ns"]))
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
        figure.suptitle(f"{timing['verdict']}: {timing['reason']}")
        figure.savefig(path, metadata={"Date": None})
