"""Reader of the logs of `dropstitch run`: goals, angles and currents of a trial.

The robot has no motion capture. Its predicted tip is kept under its own name (`predicted_tip_x_m`
…); the tip and the markers come from a second file or stay empty. Ticks without fresh data are
left out of the measured series, so that held values are not taken for samples; goals are known in
every tick.
"""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np

from firmware_py.errors import InputError
from firmware_py.log.logged_run import LoggedMotion, logged_run
from firmware_py.log.recording import Recording, read_recording
from firmware_py.motion import Motion
from firmware_py.signals import PAYLOAD, PERIOD_S, joint_signals, tip_names
from models.trials.importers.mapping import RecordingMap, Scalar
from models.trials.importers.series import Series

_HALF_WIDTHS = tuple(f"half_width_{axis}_m" for axis in "xyz")


def read_robot_log(path: Path, mapping: RecordingMap) -> list[Series]:
    """Joint signals, predictions and the estimated payload of a log, on the log's clock.

    Parameters
    ----------
    path : Path
        MCAP file.
    mapping : RecordingMap
        Not used: the log holds the contract's names and units.

    Returns
    -------
    list of Series
        One series, or goals and measured signals apart where some ticks have no fresh data.

    Raises
    ------
    InputError
        If the file is no log of `dropstitch run`.
    """
    log = read_recording(path)
    columns = log.columns
    names = [signal.name for signal in joint_signals(log.dof)]
    goals = {name: columns[name] for name in names if name.startswith("goal")}
    measured = {name: columns[name] for name in names if not name.startswith("goal")}
    predicted = (*tip_names("predicted_"), *_HALF_WIDTHS)
    measured |= {name: columns[name] for name in predicted}
    measured[f"estimated_{PAYLOAD.name}"] = columns[PAYLOAD.name]
    time_s, fresh = columns["time_s"], columns["stale_ticks"] == 0
    if fresh.all():  # one series, which keeps its samples as they are
        return [Series(time_s, goals | measured, path)]
    held = {name: column[fresh] for name, column in measured.items()}
    return [Series(time_s, goals, path), Series(time_s[fresh], held, path)]


def with_log_conditions(mapping: RecordingMap, log: Recording) -> RecordingMap:
    """Map completed from a log: `[trial]` and `step_s`, where the map does not give them.

    Parameters
    ----------
    mapping : RecordingMap
        What it gives takes precedence.
    log : Recording
        Of `dropstitch run`.

    Raises
    ------
    InputError
        If neither the log nor the map gives the payload.
    """
    facts = logged_run(log)
    motion = _motion_conditions(facts.motion)
    known: dict[str, Scalar | None] = {"dof": log.dof, **motion}
    known["source"] = log.metadata.get("source", "recording")  # a run in software says "sil"
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
    step_s = facts.period_s or float(np.median(np.diff(log.columns["time_s"])))
    return msgspec.structs.replace(
        mapping,
        trial=trial | mapping.trial,
        step_s=step_s if mapping.step_s == PERIOD_S else mapping.step_s,
    )


def _motion_conditions(logged: LoggedMotion) -> dict[str, Scalar | None]:
    """Conditions of a trial from the motion of a log."""
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
