"""Reader of the logs of `dropstitch run`: goals, angles and currents of a trial.

The robot has no motion capture: the tip and the markers come from a second file or stay empty. Its
predicted tip has columns of another name (`predicted_tip_x_m` …). Ticks without fresh data are no
samples; goals are known in every tick. Goals begin with the motion, at time zero: a trial, whose
first rows are at rest, holds neither the approach nor a probing motion, but the clock of the motion
capture is estimated from them too. Samples of a retried read are late: angle and current are
interpolated to the time of their row. Rows from an alert or an early stop on are not part of the
motion.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.bus.registers import describe_alert
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.core.errors import InputError
from firmware_py.core.signals import PAYLOAD, joint_signals, tip_names
from firmware_py.log.recording import (
    OUTSIDE,
    LoggedMotion,
    LoggedRun,
    Recording,
    logged_run,
    read_recording,
)
from firmware_py.safety.states import SafetyState
from models.trials.recordings.mapping import RecordingMap, Scalar
from models.trials.recordings.series import Series
from models.trials.trial import Array, rows_at_rest

LEAST_MOVING_ROWS: Final = 20
"""Fewest rows after the rest for rows before a stop to be a trial [assumed]: as many as an import
expects at rest."""


def motion_rows(log: Recording) -> tuple[Recording, str | None]:
    """Rows of a log in which the robot followed its motion, and why the others are not used.

    The first alert ends them, or a stop before the end of the motion. Rows of a stop after the
    motion stay: they hold its last goals.
    """
    columns = log.columns
    alert_bits = np.nan_to_num(columns["alert"])
    alert = _first((alert_bits != 0) | (columns["bus_status"] == BusStatus.ALERT))
    row = min(alert, _early_stop(log))
    if row == len(columns["tick"]):
        return log, None
    reason = "the robot stops before the end of its motion"
    if row == alert:
        bits = int(alert_bits[row])
        reason = f"a servo raises an alert ({describe_alert(bits) if bits else 'cause unknown'})"
    elif stale := int(np.nan_to_num(columns["stale_ticks"][row])):
        reason += f", without fresh data for {stale} ticks"
    text = (
        f"what {log.path.name} holds from tick {int(columns['tick'][row])} on, "
        f"{columns['time_s'][row]:.2f} s after its motion began, is left out: {reason}"
    )
    if not columns["tick"][row] >= 0:
        text = f"{log.path.name} holds no motion: {reason} during the approach"
    motion = replace(log, columns={name: column[:row] for name, column in columns.items()})
    goals = _motion_goals(motion)
    if len(goals) == 0 or len(goals) - rows_at_rest(goals) < LEAST_MOVING_ROWS:
        raise InputError(log.path, f"{text}, and hardly any motion is left", "record it again")
    return motion, text


def _early_stop(log: Recording) -> int:
    """Row in which the robot began to stop before the end of its motion; the number of rows if not.

    Where the log does not tell the end of the motion, and where another program sent the goals, a
    stop from rest counts as after it.
    """
    count, facts, goals = len(log.columns["tick"]), logged_run(log), _goals(log)
    row = _first(log.columns["state"] >= SafetyState.STOPPING)
    if row == count or (facts.slots is not None and log.columns["tick"][row] >= facts.slots):
        return count
    from_rest = bool((goals[row:] == goals[max(row - 1, 0)]).all())
    return count if from_rest and (facts.slots is None or _outside(facts)) else row


def _first(rows: NDArray[np.bool_]) -> int:
    """First true row; the number of rows if there is none."""
    return int(np.argmax(rows)) if rows.any() else len(rows)


def _goals(log: Recording) -> Array:
    return np.column_stack([log.columns[f"goal_{j}_rad"] for j in range(1, log.dof + 1)])


def _motion_goals(log: Recording) -> Array:
    """Goals from time zero on, without those of the approach."""
    return np.asarray(_goals(log)[log.columns["tick"] >= 0])


# --- signals -------------------------------------------------------------------------------------


def read_robot_log(path: Path, mapping: RecordingMap) -> list[Series]:
    """Read joint signals, predictions and estimated payload of a log, on the log's clock.

    A log has the names and units of a trial, so the map is not used. The result is one series. If
    some ticks have no fresh data, or the arm approaches the first goal, goals and measured signals
    are two series.
    """
    log, _ = motion_rows(read_recording(path))
    columns, names = log.columns, [signal.name for signal in joint_signals(log.dof)]
    goals = {name: columns[name] for name in names if name.startswith("goal")}
    predicted = (*tip_names("predicted_"), *(f"half_width_{axis}_m" for axis in "xyz"))
    measured = {name: columns[name] for name in (*names, *predicted) if name not in goals}
    measured[f"estimated_{PAYLOAD.name}"] = columns[PAYLOAD.name]
    fresh = columns["stale_ticks"] == 0
    fresh = fresh & _interpolate_late(columns, fresh, measured, set(names))
    time_s, begun = columns["time_s"], columns["tick"] >= 0
    if fresh.all() and begun.all():  # one series keeps its samples unchanged
        return [Series(time_s, goals | measured, path)]
    return [
        Series(time_s[begun], {n: v[begun] for n, v in goals.items()}, path),
        Series(time_s[fresh], {n: v[fresh] for n, v in measured.items()}, path),
    ]


def _interpolate_late(
    columns: dict[str, NDArray[Any]],
    fresh: NDArray[np.bool_],
    measured: dict[str, Array],
    sampled: set[str],
) -> NDArray[np.bool_]:
    """Interpolate the samples of retried reads, in place, to the times of their rows.

    Their delay is counted from the usual time of a sample that is answered at the first attempt.
    Returned are the rows with a value: a late first sample has none before it.
    """
    status, after_ns, time_s = columns["bus_status"], columns["sample_late_ns"], columns["time_s"]
    at_once, again = status == BusStatus.OK, status == BusStatus.RETRIED
    if not at_once.any() or not again.any():
        return np.ones(len(status), dtype=bool)
    late_s = np.where(again, 1e-9 * (after_ns - np.median(after_ns[at_once])), 0.0)
    late_s = np.maximum(np.nan_to_num(late_s), 0.0)
    late, sample_s = fresh & (late_s > 0), (time_s + late_s)[fresh]
    for name in sampled & measured.keys():
        column = measured[name].copy()
        column[late] = np.interp(time_s[late], sample_s, measured[name][fresh])
        measured[name] = column
    return np.asarray(~(late & (time_s < sample_s[0])))


# --- conditions ----------------------------------------------------------------------------------


def with_log_conditions(mapping: RecordingMap, log: Recording) -> RecordingMap:
    """Complete `[trial]` and `step_s` of a map from a log."""
    facts = logged_run(log)
    step_s = facts.period_s or float(np.median(np.diff(log.columns["time_s"])))
    if facts.payload_kg is None and "payload_kg" not in mapping.trial:
        raise InputError(
            mapping.path, "payload_kg is missing, and robot.toml did not give it",
            "add it under [trial] of MAP.toml",
        )  # fmt: skip
    conditions = _goals_reach(log, step_s) if _outside(facts) else _motion_conditions(facts.motion)
    conditions |= {"dof": log.dof, "payload_kg": facts.payload_kg}
    conditions["source"] = log.metadata.get("source", "recording")  # a run in software has "sil"
    known = {key: value for key, value in conditions.items() if value is not None}
    return msgspec.structs.replace(
        mapping,
        trial=known | mapping.trial,
        step_s=mapping.step_s if mapping.step_named else step_s,
    )


def _outside(facts: LoggedRun) -> bool:
    """Whether another program sent the goals."""
    return facts.motion.motion == OUTSIDE


def _goals_reach(log: Recording, step_s: float) -> dict[str, Scalar | None]:
    """Conditions of goals from another program: their duration and the largest goal."""
    goals = _motion_goals(log)
    if not len(goals) or not np.isfinite(goals).all():
        raise InputError(log.path, "holds no goals", "record it again")
    moving = max(len(goals) - rows_at_rest(goals), 1)
    return {
        "motion": OUTSIDE, "period_s": moving * step_s,
        "amplitude_rad": float(np.abs(goals).max()), "phase_2_rad": 0.0,
    }  # fmt: skip


def _motion_conditions(motion: LoggedMotion) -> dict[str, Scalar | None]:
    return {
        "motion": motion.motion or motion.kind, "period_s": motion.period_s,
        "amplitude_rad": motion.amplitude_rad, "phase_2_rad": motion.phase_2_rad,
    }  # fmt: skip
