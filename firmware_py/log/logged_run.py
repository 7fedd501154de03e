"""Facts about the run of a log, checked: period, payload, motion."""

from __future__ import annotations

import math
from typing import Final, TypeVar

import msgspec

from firmware_py.errors import InputError
from firmware_py.log.recording import Recording
from firmware_py.motion_document import MotionDocument, check_motion_document

__all__ = ["OUTSIDE", "SLOTS_KEY", "LoggedMotion", "LoggedRun", "logged_run"]

SLOTS_KEY: Final = "slots"
"""Name of the slots to run among the metadata."""
OUTSIDE: Final = "outside"
"""Name of the motion where another program sent the goals, in logs and trials."""

T = TypeVar("T")


class LoggedMotion(msgspec.Struct, frozen=True):
    """Motion of a run: of a plan, or the table `[motion]` of its robot.toml."""

    motion: str | None = None  # Name, in the log of a plan; kind, in that of a configured motion
    kind: str | None = None
    period_s: float | None = None  # Conditions, where they are known
    amplitude_rad: float | None = None
    phase_2_rad: float | None = None
    design: MotionDocument | None = None  # Content of a motion file


class _LoggedConfig(msgspec.Struct, frozen=True):
    """What is used of the robot.toml of a run."""

    motion: LoggedMotion = LoggedMotion()
    payload_kg: float | None = None


class LoggedRun(msgspec.Struct, frozen=True):
    """Facts of a log."""

    period_s: float | None
    payload_kg: float | None  # Mass at the tip as the log states it
    assumed_payload_kg: float | None  # Mass that robot.toml gave to the estimator
    motion: LoggedMotion
    # Whether a probing motion preceded it, after which the observer was told the payload
    probed: bool = False
    # Slots after which the run was to end; None where the log does not say
    slots: int | None = None


def logged_run(log: Recording) -> LoggedRun:
    """Facts that the metadata of a log hold."""
    config = _decoded(log, "config", "{}", _LoggedConfig)
    period_s = _decoded(log, "period_s", "null", float | None)  # type: ignore[arg-type]
    if period_s is not None and not 1e-3 <= period_s <= 1.0:
        raise _damaged(log, "period_s", f"{period_s} s is outside 0.001 to 1 s")
    payload_kg: float | None = _decoded(log, "payload_kg", "null", float | None)  # type: ignore[arg-type]
    motion = config.motion
    if "motion" in log.metadata:
        motion = _decoded(log, "motion", "{}", LoggedMotion)
    if motion.design is not None:
        check_motion_document(motion.design, log.path)
    probed = _decoded(log, "probed", "false", bool)
    slots: int | None = _decoded(log, SLOTS_KEY, "null", int | None)  # type: ignore[arg-type]
    return LoggedRun(period_s, payload_kg, config.payload_kg, motion, probed, slots)


def _decoded(log: Recording, key: str, absent: str, kind: type[T]) -> T:
    try:
        value = msgspec.json.decode(log.metadata.get(key, absent), type=kind)
    except (ValueError, RecursionError) as error:
        raise _damaged(log, key, str(error)) from None
    if isinstance(value, float) and not math.isfinite(value):
        raise _damaged(log, key, f"it is {value}")
    return value


def _damaged(log: Recording, key: str, what: str) -> InputError:
    return InputError(log.path, f"its metadata are damaged: {key} ({what})", "record it again")
