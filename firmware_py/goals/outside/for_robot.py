"""Goals from another program for one robot: channel, map that fits, facts for the log."""

from __future__ import annotations

import contextlib
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import msgspec

from firmware_py.config import RobotConfig
from firmware_py.errors import InputError
from firmware_py.goals.outside.goal_channel import accepted_program
from firmware_py.goals.outside.goal_map import GoalMap, read_goal_map
from firmware_py.goals.outside.outside_goals import OutsideGoals
from firmware_py.goals.plant_of_goals import note_on_plant
from firmware_py.inference.bundle import ModelBundle
from firmware_py.log.logged_run import OUTSIDE

__all__ = ["outside_facts", "outside_goals"]

WAIT_S: Final = 60.0
"""Longest wait for the program, before the torque is switched on [assumed]."""


@contextlib.contextmanager
def outside_goals(
    address: str,
    map_path: Path | None,
    config: RobotConfig,
    bundle: ModelBundle,
    patience_s: float = 0.0,
) -> Iterator[OutsideGoals]:
    """Wait for the program that sends goals; its connection is closed at the end.

    `config`: joints, period, limits, and the payload where it is known.
    `bundle`: the robot's bundle, whose plant is compared with that of the map.
    """
    if config.bus.replug_s > 0:  # the program's goals and the arm would part meanwhile, unnoticed
        raise InputError(
            "bus.replug_s", f"is {config.bus.replug_s:g}, but another program sends the goals, and "
            "it does not know what the arm did while the port was gone",
            "set it to 0 for runs with --goals; the robot then stays stopped",
        )  # fmt: skip
    goal_map, note = None, ""
    if map_path is not None:
        goal_map = _fitting(map_path, config)
        note = note_on_plant(str(map_path), goal_map, bundle)
    print(f"waiting at {address} for the program that sends the goals", file=sys.stderr)
    with accepted_program(address, WAIT_S, patience_s) as channel:
        yield OutsideGoals(
            channel, config.limits_in_force, config.dof, config.period_s, goal_map,
            config.payload_kg, note,
        )  # fmt: skip


def _fitting(path: Path, config: RobotConfig) -> GoalMap:
    found = read_goal_map(path)
    if found.dof != config.dof:
        raise InputError(
            path, f"is for {found.dof} joints, the robot has {config.dof}", "make anew"
        )
    if not math.isclose(found.period_s, config.period_s):
        raise InputError(
            path, f"has a period of {found.period_s:g} s, the robot {config.period_s:g} s",
            "make it anew",
        )  # fmt: skip
    return found


def outside_facts() -> dict[str, str]:
    """Return what the log of such a run holds in place of the configured motion.

    Duration and amplitude are unknown when the log begins: whoever reads it takes them from its
    goals.
    """
    return {"motion": msgspec.json.encode({"motion": OUTSIDE}).decode(), "rest_samples": "1"}
