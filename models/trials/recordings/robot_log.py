"""Reader of the logs of `dropstitch run`: goals, angles and currents of a trial.

The robot has no motion capture. Its predicted tip gets its own columns (`predicted_tip_x_m` …); the
tip and the markers come from a second file or stay empty. Ticks without fresh data are left out of
the measured series, so that stale values do not become samples; goals are known in every tick.
Goals begin with the motion, at time zero: a trial, whose first rows are at rest, holds neither the
approach nor a probing motion. The clock of the motion capture is estimated from both, however.
Samples of a retried read are late: angle and current are interpolated to the time of their row.
Rows from an alert or an early stop on are not part of the motion.
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
from firmware_py.errors import InputError
from firmware_py.log.logged_run import OUTSIDE, LoggedMotion, LoggedRun, logged_run
from firmware_py.log.recording import Recording, read_recording
from firmware_py.motion import Motion
from firmware_py.safety.states import SafetyState
from firmware_py.signals import PAYLOAD, joint_signals, tip_names
from models.trials.recordings.mapping import RecordingMap, Scalar
from models.trials.recordings.series import Series
from models.trials.trial import Array, rows_at_rest

LEAST_MOVING_ROWS: Final = 20
"""Fewest rows after the rest for rows before a stop to be a trial [assumed]: as many as an import
expects at rest."""
_HALF_WIDTHS = tuple(f"half_width_{axis}_m" for axis in "xyz")


def motion_rows(log: Recording) -> tuple[Recording, str | None]:
    """Rows of a log in which the robot followed its motion, and why the others are left out.

    The first alert ends them, or a stop before the end of the motion. Rows of a stop after the
    motion stay: they hold its last goals.
    """
    alert, stop = _first_alert(log), _early_stop(log)
    found = [row for row in (alert, stop) if row is not None]
    if not found:
        return log, None
    row, columns = min(found), log.columns
    reason = "the robot stops before the end of its motion"
    if row == alert:
        bits = int(_bits(columns)[row])
        reason = f"a servo raises an alert ({describe_alert(bits) if bits else 'cause unknown'})"
    elif stale := int(np.nan_to_num(columns["stale_ticks"][row])):
        reason += f", without fresh data for {stale} ticks"
    text = (
        f"what {log.path.name} holds from tick {int(columns['tick'][row])} on, "
        f"{columns['time_s'][row]:.2f} s after its motion began, is left out: {reason}"
    )
    if not columns["tick"][row] >= 0:
        text = f"{log.path.name} holds no motion: {reason} during the approach"
    left = {name: column[:row] for name, column in columns.items()}
    goals = _motion_goals(replace(log, columns=left))
    if len(goals) == 0 or len(goals) - rows_at_rest(goals) < LEAST_MOVING_ROWS:
        raise InputError(log.path, f"{text}, and hardly any motion is left", "record it again")
    return replace(log, columns=left), text


def read_robot_log(path: Path, mapping: RecordingMap) -> list[Series]:
    """Read joint signals, predictions and estimated payload of a log, on the log's clock.

    A log has the names and units of a trial, so the map is not used. The result is one series. If
    some ticks have no fresh data, or the arm approaches the first goal, goals and measured signals
    are two series.
    """
    log, _ = motion_rows(read_recording(path))
    columns = log.columns
    names = [signal.name for signal in joint_signals(log.dof)]
    goals = {name: columns[name] for name in names if name.startswith("goal")}
    sampled = {name: columns[name] for name in names if not name.startswith("goal")}
    time_s, fresh = columns["time_s"], columns["stale_ticks"] == 0
    fresh, sampled = _at_rows(time_s, fresh, _late_s(columns), sampled)
    predicted = (*tip_names("predicted_"), *_HALF_WIDTHS)
    measured = sampled | {name: columns[name] for name in predicted}
    measured[f"estimated_{PAYLOAD.name}"] = columns[PAYLOAD.name]
    begun = columns["tick"] >= 0
    if fresh.all() and begun.all():  # one series keeps its samples unchanged
        return [Series(time_s, goals | measured, path)]
    held = {name: column[fresh] for name, column in measured.items()}
    goals = {name: column[begun] for name, column in goals.items()}
    return [Series(time_s[begun], goals, path), Series(time_s[fresh], held, path)]


def with_log_conditions(mapping: RecordingMap, log: Recording) -> RecordingMap:
    """Complete `[trial]` and `step_s` of a map from a log."""
    facts = logged_run(log)
    step_s = facts.period_s or float(np.median(np.diff(log.columns["time_s"])))
    motion = _goals_reach(log, step_s) if _outside(facts) else _motion_conditions(facts.motion)
    known: dict[str, Scalar | None] = {"dof": log.dof, **motion}
    known["source"] = log.metadata.get("source", "recording")  # a run in software has "sil"
    known["payload_kg"] = facts.payload_kg
    if facts.payload_kg is None and "payload_kg" not in mapping.trial:
        estimated_kg = log.columns[PAYLOAD.name]
        seen = np.isfinite(estimated_kg)
        guess = f", the loop estimated {np.median(estimated_kg[seen]):.2g} kg" if seen.any() else ""
        raise InputError(
            mapping.path, f"payload_kg is missing, and robot.toml did not give it{guess}",
            "add it under [trial] of MAP.toml",
        )  # fmt: skip
    trial = {key: value for key, value in known.items() if value is not None}
    return msgspec.structs.replace(
        mapping,
        trial=trial | mapping.trial,
        step_s=mapping.step_s if mapping.step_named else step_s,
    )


def _first_alert(log: Recording) -> int | None:
    rows = np.flatnonzero(
        (_bits(log.columns) != 0) | (log.columns["bus_status"] == BusStatus.ALERT)
    )
    return int(rows[0]) if len(rows) else None


def _bits(columns: dict[str, NDArray[Any]]) -> Array:
    return np.asarray(np.nan_to_num(columns["alert"]))


def _early_stop(log: Recording) -> int | None:
    """Row in which the robot began to stop, unless its motion was over.

    If the log does not tell the end of the motion, a stop from rest counts as after it.
    """
    rows = np.flatnonzero(log.columns["state"] >= SafetyState.STOPPING)
    if not len(rows):
        return None
    row, facts = int(rows[0]), logged_run(log)
    if facts.slots is not None and log.columns["tick"][row] >= facts.slots:
        return None
    goals = _goals(log)
    from_rest = bool((goals[row:] == goals[max(row - 1, 0)]).all())
    return None if from_rest and (facts.slots is None or _outside(facts)) else row


def _goals(log: Recording) -> Array:
    return np.column_stack([log.columns[f"goal_{j}_rad"] for j in range(1, log.dof + 1)])


def _motion_goals(log: Recording) -> Array:
    """Goals from time zero on, without those of the approach."""
    return np.asarray(_goals(log)[log.columns["tick"] >= 0])


def _late_s(columns: dict[str, NDArray[Any]]) -> Array:
    """Delay of each row's sample after a retried read, else zero.

    It is counted from the usual time of a sample that is answered at the first attempt.
    """
    status, after_ns = columns["bus_status"], columns["sample_late_ns"]
    at_once, again = status == BusStatus.OK, status == BusStatus.RETRIED
    if not at_once.any() or not again.any():
        return np.zeros(len(status))
    late_s = np.where(again, 1e-9 * (after_ns - np.median(after_ns[at_once])), 0.0)
    return np.asarray(np.maximum(np.nan_to_num(late_s), 0.0))


def _at_rows(
    time_s: Array, fresh: NDArray[np.bool_], late_s: Array, sampled: dict[str, Array]
) -> tuple[NDArray[np.bool_], dict[str, Array]]:
    """Mask of the measured rows, and late samples interpolated to the time of their row."""
    late = fresh & (late_s > 0)
    if not late.any():
        return fresh, sampled
    sample_s = (time_s + late_s)[fresh]
    own = {}
    for name, column in sampled.items():
        own[name] = column.copy()
        own[name][late] = np.interp(time_s[late], sample_s, column[fresh])
    return fresh & ~(late & (time_s < sample_s[0])), own  # the first sample has none before it


def _outside(facts: LoggedRun) -> bool:
    """Whether another program sent the goals."""
    return facts.motion.design is None and facts.motion.motion == OUTSIDE


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


def _motion_conditions(logged: LoggedMotion) -> dict[str, Scalar | None]:
    """Conditions of a trial from the logged motion."""
    if logged.design is None:
        return {
            "motion": logged.motion or logged.kind, "period_s": logged.period_s,
            "amplitude_rad": logged.amplitude_rad, "phase_2_rad": logged.phase_2_rad,
        }  # fmt: skip
    motion = Motion.designed(logged.design)
    return {
        "motion": motion.name, "period_s": motion.period_s, "amplitude_rad": motion.amplitude_rad,
        "phase_2_rad": motion.phase_2_rad,
    }  # fmt: skip
