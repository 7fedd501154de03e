"""Messages between the robot and a program that sends goals, one JSON object a message.

In every tick the robot sends a `StatusMessage`; the program answers with a `GoalMessage`. The form
is documented in docs/tip/goals.md.
"""

from __future__ import annotations

import math
from typing import Final

import msgspec

__all__ = ["GoalMessage", "StatusMessage", "decode_goal", "encode_goal", "encode_status"]

MOST_BYTES: Final = 512
"""Longest message that is read [assumed]: one of two joints has 70."""


class GoalMessage(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Goals that a program sends; one of `joint_rad`, `tip_m` and `end` is given."""

    tick: int  # Number of the status that it answers
    joint_rad: tuple[float, ...] | None = None
    # Place of the tip in the world frame: x, and y where there are two joints
    tip_m: tuple[float, ...] | None = None
    end: bool = False  # Whether the run is over: the robot stops without a fault


class StatusMessage(msgspec.Struct, frozen=True):
    """State of the robot after a tick."""

    tick: int
    time_s: float  # Time since the start
    state: str  # State of the safety supervisor
    goal_rad: tuple[float, ...]  # Goals sent and angles measured, one per joint
    angle_rad: tuple[float, ...]
    tip_m: tuple[float, ...]  # Predicted tip, x, y and z in the world frame
    in_range: bool  # Whether the prediction is inside its training range
    payload_kg: float | None  # Estimated mass at the tip; None where it is not estimated
    reason: str = ""  # Cause of a stop; empty before


_DECODER: Final = msgspec.json.Decoder(GoalMessage)
_ENCODER: Final = msgspec.json.Encoder()


def decode_goal(data: bytes, dof: int) -> GoalMessage | str:
    """Return the goals of a message, or a sentence that says what is wrong with it."""
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
    """Return a message with goals, for programs in Python."""
    return _ENCODER.encode(goal)


def encode_status(status: StatusMessage) -> bytes:
    """Return a message with the state of the robot; NaN becomes null."""
    return _ENCODER.encode(status)
