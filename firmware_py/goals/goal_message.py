"""Messages between the robot and a program that sends goals, one JSON object each.

In every tick the robot sends a `StatusMessage`; the program answers with a `GoalMessage`.
docs/tip/goals.md documents the format.
"""

from __future__ import annotations

import math
from typing import Final

import msgspec

__all__ = ["GoalMessage", "StatusMessage", "decode_goal", "encode_goal", "encode_status"]

MOST_BYTES: Final = 512
"""Length of the longest message that is read [assumed]; a message for two joints has 70."""


class GoalMessage(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Goals from a program: exactly one of `joint_rad`, `tip_m` and `end`."""

    tick: int  # `tick` of the status message that it answers
    joint_rad: tuple[float, ...] | None = None
    # Position of the tip in the world frame: x, and y with two joints
    tip_m: tuple[float, ...] | None = None
    end: bool = False  # Whether to end the run without a fault


class StatusMessage(msgspec.Struct, frozen=True):
    """State of the robot after a tick."""

    tick: int
    time_s: float  # Time since the start of the motion
    state: str  # State of the safety supervisor
    goal_rad: tuple[float, ...]  # Goals sent, one per joint
    angle_rad: tuple[float, ...]  # Measured angles, one per joint
    tip_m: tuple[float, ...]  # Predicted tip, x, y and z in the world frame
    in_range: bool  # Whether the inputs of the predictor are in its training range
    payload_kg: float | None  # Estimated mass at the tip; None if it is not estimated
    reason: str = ""  # Reason of the stop; empty before


_DECODER: Final = msgspec.json.Decoder(GoalMessage)
_ENCODER: Final = msgspec.json.Encoder()


def decode_goal(data: bytes, dof: int) -> GoalMessage | str:
    """Return the goals of a message, or a description of its error."""
    if len(data) > MOST_BYTES:
        return f"has more than {MOST_BYTES} bytes"
    try:
        goal = _DECODER.decode(data)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        return f"cannot be read ({error})"
    if (goal.joint_rad is not None) + (goal.tip_m is not None) + goal.end != 1:
        return "needs one of joint_rad, tip_m and end"
    values = goal.joint_rad or goal.tip_m or ()
    if not goal.end and len(values) != dof:
        return f"has {len(values)} values for {dof} joints"
    if not all(map(math.isfinite, values)):
        return "has a value that is not finite"
    return goal


def encode_goal(goal: GoalMessage) -> bytes:
    """Return the message of goals, for programs in Python."""
    return _ENCODER.encode(goal)


def encode_status(status: StatusMessage) -> bytes:
    """Return the message of a status; NaN becomes null."""
    return _ENCODER.encode(status)
