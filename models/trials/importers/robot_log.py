"""Our own logs: what `dropstitch run` recorded, as a trial's servo side.

The robot has no motion capture. Its prediction stays a prediction (`predicted_tip_x_m` …); the
tip and the markers come from a second file, or stay empty. Ticks without fresh data are left out
of what was measured, so that held values never pass for samples; goals are known in every tick.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from firmware_py.log.recording import Recording, read_recording
from firmware_py.signals import PAYLOAD, PERIOD_S, joint_signals, tip_names
from models.trials.importers.mapping import Mapping
from models.trials.importers.series import Series

_HALF_WIDTHS = tuple(f"half_width_{axis}_m" for axis in "xyz")


def read(path: Path, mapping: Mapping) -> list[Series]:
    """Joint signals, predictions and the estimated payload of a log, on the log's own clock."""
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


def with_conditions(mapping: Mapping, log: Recording) -> Mapping:
    """Complete `[trial]` and `step_s` of a map by what the log knows; the map's own word holds."""
    known = conditions(log)
    step_s = known.pop("step_s")
    return msgspec.structs.replace(
        mapping,
        trial=known | mapping.trial,
        step_s=step_s if mapping.step_s == PERIOD_S else mapping.step_s,
    )


def conditions(log: Recording) -> dict[str, Any]:
    """Conditions of a trial as far as a log knows them, and its `step_s`."""
    config = json.loads(log.metadata.get("config", "{}"))
    motion = config.get("motion", {})
    known = {
        "dof": log.dof,
        "source": "recording",
        "motion": motion.get("kind"),
        "period_s": motion.get("period_s"),
        "amplitude_rad": motion.get("amplitude_rad"),
        "phase_2_rad": motion.get("phase_2_rad"),
        "payload_kg": json.loads(log.metadata.get("payload_kg", "null")),
        "step_s": float(log.metadata.get("period_s", np.median(np.diff(log.columns["time_s"])))),
    }
    return {key: value for key, value in known.items() if value is not None}
