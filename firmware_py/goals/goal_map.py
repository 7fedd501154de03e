"""Map from tip positions to the goals at which the tip rests there, and the first mode, by payload.

`dropstitch goalmap` writes it, the robot reads it. The goals come from the inverted twin, for
approaches from upright with a ramp of 4 s and a hold of 10 s (`models.plan.rest_map`). The
mode tunes the zero-vibration shaper.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import ClassVar, Final

import msgspec
import numpy as np

from firmware_py.core.documents import Document, read_document
from firmware_py.core.errors import InputError
from firmware_py.goals.goal_source import interval_of
from firmware_py.link.link_facts import LinkFacts

MOST_PLACES: Final = 201
"""Most positions along an axis of a map that is read [assumed]."""


class PayloadMap(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Map for one payload."""

    payload_kg: float
    # Goals of each joint at each position, the last coordinate varying fastest; null where the tip
    # cannot rest
    goals_rad: tuple[tuple[float | None, ...], ...]
    half_period_s: tuple[float, ...]  # Half period of the first mode, one per joint
    decay: tuple[float, ...]  # Ratio of the mode's amplitudes after and before half a period


class GoalMap(Document, frozen=True):
    """Goals at which the tip rests, by tip position and payload."""

    VERSION: ClassVar[int] = 1
    MADE_BY: ClassVar[str] = "dropstitch goalmap"

    dof: int  # Number of joints; positions are x, and y with two joints
    period_s: float
    places_m: tuple[float, ...]  # Positions along each axis, rising and evenly spaced
    payloads: tuple[PayloadMap, ...]  # Map of each payload, in rising order
    plant_sha256: str  # Hash of the plant, as in the manifest of a bundle
    link: LinkFacts


def read_goal_map(path: Path) -> GoalMap:
    goal_map = read_document(path, GoalMap)
    if wrong := _wrong_in(goal_map):
        raise InputError(path, wrong, f"write it anew with {GoalMap.MADE_BY}")
    return goal_map


def _wrong_in(goal_map: GoalMap) -> str:
    places, count = np.array(goal_map.places_m), len(goal_map.places_m)
    if goal_map.dof not in (1, 2):
        return f"is for {goal_map.dof} joints; 1 or 2 can move"
    if not 2 <= count <= MOST_PLACES or not np.isfinite(places).all():
        return f"needs 2 to {MOST_PLACES} finite places_m"
    steps = np.diff(places)
    if steps[0] <= 0 or not np.allclose(steps, steps[0]):
        return "has places_m that do not rise evenly"
    grid = [payload.payload_kg for payload in goal_map.payloads]
    if not grid or grid[0] < 0 or not all(b > a for a, b in pairwise(grid)):
        return "has payloads that are negative or do not rise, or none"
    for payload in goal_map.payloads:
        if [len(c) for c in payload.goals_rad] != [count**goal_map.dof] * goal_map.dof:
            return f"needs {goal_map.dof} columns of {count**goal_map.dof} goals"
        modes = (*payload.half_period_s, *payload.decay)
        if len(modes) != 2 * goal_map.dof or not all(0.0 < v < 10.0 for v in modes):
            return "has modes that cannot be"
    return ""


class RestGoals:
    def __init__(self, goal_map: GoalMap) -> None:
        places = goal_map.places_m
        self._low, self._step = places[0], (places[-1] - places[0]) / (len(places) - 1)
        self._count, self._dof = len(places), goal_map.dof
        self.grid_kg = [payload.payload_kg for payload in goal_map.payloads]
        # Lists, not arrays: a tick reads few numbers, one at a time.
        self._goals = [
            [list(column) for column in payload.goals_rad] for payload in goal_map.payloads
        ]
        self._half = [payload.half_period_s for payload in goal_map.payloads]
        self._decay = [payload.decay for payload in goal_map.payloads]
        self.longest_s = max(max(half) for half in self._half)

    def goals_rad(self, tip_m: tuple[float, ...], payload_kg: float) -> list[float] | None:
        """Return the goals at which the tip rests at a position; None if it cannot rest there.

        `payload_kg`: mass at the tip, clipped to the grid.
        """
        corners, count = [(0, 1.0)], self._count
        for value in tip_m:
            at = (value - self._low) / self._step
            if not 0.0 <= at <= count - 1:
                return None
            k = min(int(at), count - 2)
            part = at - k
            corners = [
                (index * count + k + side, weight * (part if side else 1.0 - part))
                for index, weight in corners
                for side in (0, 1)
            ]
        low, part = interval_of(self.grid_kg, payload_kg)
        result = [0.0] * self._dof
        high = low + 1 if part else low
        for table, share in ((self._goals[low], 1.0 - part), (self._goals[high], part)):
            for joint, column in enumerate(table):
                for index, weight in corners:
                    if weight == 0.0 or share == 0.0:
                        continue
                    if (goal := column[index]) is None:
                        return None
                    result[joint] += share * weight * goal
        return result

    def mode(self, payload_kg: float) -> tuple[list[float], list[float]]:
        """Return half period in s and decay of the first mode, one per joint.

        `payload_kg`: mass at the tip, clipped to the grid.
        """
        low, part = interval_of(self.grid_kg, payload_kg)
        high = low + 1 if part else low
        return (
            [a + part * (b - a) for a, b in zip(self._half[low], self._half[high], strict=True)],
            [a + part * (b - a) for a, b in zip(self._decay[low], self._decay[high], strict=True)],
        )
