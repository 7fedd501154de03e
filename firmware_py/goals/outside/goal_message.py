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
    """Goals that a program sends; one of `joint_rad`, `tip_m` and `end` is given.

    Attributes
    ----------
    tick : int
        Number of the status that it answers.
    joint_rad : tuple of float or None
        Goal of each joint.
    tip_m : tuple of float or None
        Place of the tip in the world frame: x, and y where there are two joints.
    end : bool
        Whether the run is over: the robot stops without a fault.
    """

    tick: int
    joint_rad: tuple[float, ...] | None = None
    tip_m: tuple[float, ...] | None = None
    end: bool = False


class StatusMessage(msgspec.Struct, frozen=True):
    """State of the robot after a tick.

    Attributes
    ----------
    tick : int
        Number of the tick.
    time_s : float
        Time since the start.
    state : str
        State of the safety supervisor.
    goal_rad, angle_rad : tuple of float
        Goals sent and angles measured, one per joint.
    tip_m : tuple of float
        Predicted tip, x, y and z in the world frame.
    in_range : bool
        Whether the prediction is inside its training range.
    payload_kg : float or None
        Estimated mass at the tip; None where it is not estimated.
    reason : str
        Cause of a stop; empty before.
    """

    tick: int
    time_s: float
    state: str
    goal_rad: tuple[float, ...]
    angle_rad: tuple[float, ...]
    tip_m: tuple[float, ...]
    in_range: bool
    payload_kg: float | None
    reason: str = ""


_DECODER: Final = msgspec.json.Decoder(GoalMessage)
_ENCODER: Final = msgspec.json.Encoder()


def decode_goal(data: bytes, dof: int) -> GoalMessage | str:
    """Return the goals of a message, or a sentence that says what is wrong with it.

    Parameters
    ----------
    data : bytes
        One message.
    dof : int
        Joints of the robot.

    Examples
    --------
    >>> decode_goal(b'{"tick": 3, "joint_rad": [0.1]}', 1)
    GoalMessage(tick=3, joint_rad=(0.1,), tip_m=None, end=False)
    >>> decode_goal(b'{"tick": 3, "joint_rad": [0.1]}', 2)
    'has 1 values for 2 joints'
    """
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
