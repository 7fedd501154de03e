"""Facts about the run of a log, checked: period, payload, motion."""

from __future__ import annotations

import math
from typing import Final, TypeVar

import msgspec

from firmware_py.core.errors import InputError
from firmware_py.core.motion_document import MotionDocument, check_motion_document
from firmware_py.log.recording import Recording

__all__ = ["OUTSIDE", "SLOTS_KEY", "LoggedMotion", "LoggedRun", "logged_run"]

SLOTS_KEY: Final = "slots"
"""Key of the requested number of slots in the metadata of a log."""
OUTSIDE: Final = "outside"
"""Name of the motion in logs and trials if another program sent the goals."""

T = TypeVar("T")


class LoggedMotion(msgspec.Struct, frozen=True):
    """Motion of a run: of a plan, or the table `[motion]` of its robot.toml."""

    motion: str | None = None  # Name, in the log of a plan
    kind: str | None = None  # Kind, in the log of a configured motion
    period_s: float | None = None  # Conditions; None if unknown
    amplitude_rad: float | None = None
    phase_2_rad: float | None = None
    design: MotionDocument | None = None  # Content of a motion file


class _LoggedConfig(msgspec.Struct, frozen=True):
    """Part of a run's robot.toml that readers use."""

    motion: LoggedMotion = LoggedMotion()
    payload_kg: float | None = None


class LoggedRun(msgspec.Struct, frozen=True):
    period_s: float | None
    payload_kg: float | None  # Mass at the tip, from the metadata
    assumed_payload_kg: float | None  # Mass that the estimator assumed, from robot.toml
    motion: LoggedMotion
    # Whether a probing motion preceded the run, which may have set the observer's payload
    probed: bool = False
    # Requested number of slots; None if the log does not contain it
    slots: int | None = None


def logged_run(log: Recording) -> LoggedRun:
    """Decode the facts in the metadata of a log."""
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
