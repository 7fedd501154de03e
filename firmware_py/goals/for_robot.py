"""Goals from another program for one robot: channel, matching map, metadata of the log."""

from __future__ import annotations

import contextlib
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import msgspec

from firmware_py.config import RobotConfig
from firmware_py.core.errors import InputError
from firmware_py.goals.goal_channel import accepted_program
from firmware_py.goals.goal_map import GoalMap, read_goal_map
from firmware_py.goals.outside_goals import OutsideGoals
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
    """Wait for the program that sends goals, and yield its goals; at the end the connection closes.

    `bundle`: the robot's bundle, whose plant is compared with that of the map.
    `patience_s`: see `SocketChannel`.
    """
    if config.bus.replug_s > 0:  # during the wait the goals would move away from the arm
        raise InputError(
            "bus.replug_s", f"is {config.bus.replug_s:g}, but another program sends the goals, and "
            "it does not know what the arm did while the port was gone",
            "set it to 0 for runs with --goals; the robot then stays stopped",
        )  # fmt: skip
    goal_map, note = None, ""
    if map_path is not None:
        goal_map = _fitting(map_path, config)
        note = note_on_plant(str(map_path), goal_map.plant_sha256, goal_map.link, bundle)
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
    """Return the metadata of such a log, which replace those of the configured motion.

    Duration and amplitude are unknown when the log begins; readers derive them from the goals.
    """
    return {"motion": msgspec.json.encode({"motion": OUTSIDE}).decode(), "rest_samples": "1"}
