"""Findings on the payloads of trials: the load in current or bend, against the declared payload."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from models.shared.kinematics import pointing_angles_rad
from models.trials.trial import Trial
from models.trials.verdict.finding import REPEATED_LOAD, ImportFinding
from models.trials.verdict.motion_findings import LEAST_MOTION_RAD, current_terms

_CLEAR: Final = 0.5
"""Smallest fraction of the current that follows the angle's sine, to estimate the load."""
_LEAST_BEND: Final = 0.02
"""Smallest bend of the link, relative to the angle, for an estimate of the load."""
_FALL: Final = 0.1
"""Relative decrease of the load towards a larger payload that is significant."""
_BETWEEN: Final = 0.2
"""Distance of a payload from the interpolation of its neighbours' loads, relative to the range of
the payloads. The rig's load is in proportion to the payload within 3 %."""


def judge_payloads(trials: Sequence[Trial]) -> list[ImportFinding]:
    """Findings on payloads that do not match the load, among trials of one motion.

    The load is the current in proportion to the angle's sine (weight times lever, and inertia), or
    the bend in proportion to the angle. It is compared between trials, not with a nominal link: it
    must be equal for equal payloads, larger for a larger one, and between those of its neighbours.
    """
    groups: dict[tuple[object, ...], list[Trial]] = defaultdict(list)
    for t in trials:
        moved = (t.meta.dof, t.meta.motion, t.meta.period_s, t.meta.amplitude_rad)
        groups[(*moved, t.meta.phase_2_rad, t.meta.pressure_pa)].append(t)
    found = []
    for group in groups.values():
        # One joint for all: with similar motions, trials would differ in the joint that moves most.
        joint = int(np.argmax(np.mean([t.angle_rad.std(axis=0) for t in group], axis=0)))
        for load, what in ((_current_load, "current"), (_bend_load, "bend")):
            loads = [load(t, joint) for t in group]
            if all(value is not None for value in loads):
                found += _of_one_motion(group, [v for v in loads if v is not None], what)
                break
    return found


def _current_load(trial: Trial, joint: int) -> float | None:
    """Current per sine of a joint's angle; None if it is not significant."""
    angle, current = trial.angle_rad[:, joint], trial.current_a[:, joint]
    if angle.std() < LEAST_MOTION_RAD or not np.isfinite(current).all():
        return None
    load = float(current_terms(current, angle, trial.step_s)[0][1])
    return abs(load) if abs(load) * np.sin(angle).std() > _CLEAR * current.std() else None


def _bend_load(trial: Trial, joint: int) -> float | None:
    """Bend in a joint's plane per angle; None if the tip is occluded or the bend is small."""
    seen = np.isfinite(trial.tip_m).all(axis=1)
    angle = trial.angle_rad[seen, joint]
    if seen.mean() < 0.5 or angle.std() < LEAST_MOTION_RAD:
        return None
    bend = pointing_angles_rad(trial.tip_m[seen])[:, joint] - angle
    moved = angle - angle.mean()
    load = float(moved @ bend / (moved @ moved))
    return abs(load) if abs(load) > _LEAST_BEND else None


def _of_one_motion(
    trials: Sequence[Trial], loads: Sequence[float], what: str
) -> list[ImportFinding]:
    by_payload: dict[float, dict[str, float]] = defaultdict(dict)
    for trial, load in sorted(zip(trials, loads, strict=True), key=lambda p: p[0].meta.payload_kg):
        by_payload[trial.meta.payload_kg][trial.name] = load
    for payload_kg, named in by_payload.items():
        low, high = min(named, key=named.__getitem__), max(named, key=named.__getitem__)
        if named[high] > (1 + REPEATED_LOAD) * named[low]:
            return [
                _finding(
                    f"{low} and {high} are both of {payload_kg:g} kg, but the {what} shows "
                    f"{named[high] / named[low]:.2f} times the load in the second"
                )
            ]  # fmt: skip
    means = {
        payload_kg: float(np.mean([*named.values()])) for payload_kg, named in by_payload.items()
    }
    return _between_payloads(means, what)


def _between_payloads(means: Mapping[float, float], what: str) -> list[ImportFinding]:
    payloads, loads = list(means), list(means.values())
    for k in range(len(payloads) - 1):
        if loads[k + 1] < (1 - _FALL) * loads[k]:
            return [
                _finding(
                    f"the {what} shows less load in the trials of {payloads[k + 1]:g} kg than in "
                    f"those of {payloads[k]:g} kg"
                )
            ]  # fmt: skip
    for k in range(1, len(payloads) - 1):
        around_kg, around = (v[k - 1 : k + 2 : 2] for v in (payloads, loads))
        if around[1] <= (1 + REPEATED_LOAD) * around[0]:
            continue
        seen_kg = float(np.interp(loads[k], around, around_kg))
        if abs(seen_kg - payloads[k]) > _BETWEEN * (payloads[-1] - payloads[0]):
            return [
                _finding(
                    f"the {what} shows {seen_kg:.2g} kg in the trials of {payloads[k]:g} kg, by "
                    f"those of {around_kg[0]:g} and {around_kg[1]:g} kg"
                )
            ]  # fmt: skip
    return []


def _finding(text: str) -> ImportFinding:
    return ImportFinding("warning", "payload", text, "correct payload_kg where it is wrong")
