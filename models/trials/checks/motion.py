"""Findings on the motion of an assembled trial: direction, signs, joints, gain, goals, currents."""

from __future__ import annotations

from typing import Final

import numpy as np

from firmware_py.display_units import ANGLE, SMALL_CURRENT
from models.shared.kinematics import base_rotation, pointing_angles_rad
from models.trials.checks.finding import (
    ACROSS,
    GAIN,
    PRESSURE_PA,
    YAW_RAD,
    ImportFinding,
    Level,
    level_of,
)
from models.trials.recordings.series import row_centre_m
from models.trials.trial import Array, Trial

LEAST_MOTION_RAD: Final = 0.03
"""Smallest standard deviation of an angle for a motion to be judged."""
LARGEST_RAD: Final = 6.3
"""Angle above which its unit is not rad."""
LARGEST: Final = (
    ("goal", "rad", LARGEST_RAD, "deg"),
    ("angle", "rad", LARGEST_RAD, "deg"),
    ("current", "a", 100.0, "mA"),
)
"""Signals of a joint: name, SI unit, value above which the unit is wrong, and the probable unit."""
LEAST_CURRENT_A: Final = 0.01
"""Peak current of a motion below which its unit is not A: friction of the smallest servo needs 0.02
to 0.04 A (docs/sources.md, "The servo")."""
SWAPPED: Final = 1.5
"""Ratio of the current's residual variance with its own joint's motion to that with the other's: at
most 0.4 on the rig, 2.4 and more if the currents are exchanged."""
ALIKE: Final = 0.9
"""Smallest correlation of two signals with the same motion."""
AMPLITUDE: Final = 0.3
"""Relative difference of the goals' amplitude from the declared one that causes a warning."""
MOVING_RAD_S: Final = 0.05
"""Speed above which friction has its full value."""


def judge_motion(trial: Trial) -> list[ImportFinding]:
    """Findings on the motion of a trial of the link, the most likely cause first."""
    found = [*_unit_findings(trial), *_condition_findings(trial)]
    if any(f.level == "refused" for f in found):
        return found
    found += [*_link_findings(trial), *_goal_findings(trial)]
    return found + _current_findings(trial)


def link_direction(trial: Trial) -> Array | None:
    """Direction of the first row (or the tip) from the joint axes, unit vectors (n, 3), or None."""
    if "m01_x_m" not in trial.columns:
        return None
    first_m = np.moveaxis(trial.marker_rows_m[:, 0], 1, 0)
    root_m = row_centre_m(first_m, trial.meta.layout.corners_m)
    if np.isfinite(root_m).all(axis=1).mean() < 0.5:
        root_m = trial.tip_m
    if np.isfinite(root_m).all(axis=1).mean() < 0.5:
        return None
    apart_m = np.linalg.norm(root_m, axis=1, keepdims=True)
    direction = root_m / np.where(apart_m > 0, apart_m, np.nan)  # the origin has no direction
    return direction if np.isfinite(direction).all(axis=1).mean() >= 0.5 else None


def _unit_findings(trial: Trial) -> list[ImportFinding]:
    """Findings on angles in degrees, currents in mA, and the reverse."""
    found = []
    for j in range(1, trial.meta.dof + 1):
        for kind, suffix, largest, unit in LARGEST:
            name = f"{kind}_{j}_{suffix}"
            reached = float(np.nanmax(np.abs(trial.columns[name])))
            if reached > largest:
                found.append(
                    ImportFinding(
                        "refused", "unit", f"{name} reaches {reached:.3g}: it is in {unit}",
                        f'set unit = "{unit}" for {name} in MAP.toml',
                    )
                )  # fmt: skip
        current = np.abs(trial.current_a[:, j - 1])
        moves = trial.angle_rad[:, j - 1].std() > LEAST_MOTION_RAD
        if moves and 0 < np.nanmax(current) < LEAST_CURRENT_A:
            found.append(
                ImportFinding(
                    "warning", "unit",
                    f"current {j} reaches {SMALL_CURRENT.significant(np.nanmax(current), 2)} only, "
                    "less than friction takes: its unit is wrong",
                    f"correct unit or scale of current_{j}_a",
                )
            )  # fmt: skip
    return found


def _condition_findings(trial: Trial) -> list[ImportFinding]:
    """Findings on an impossible pressure."""
    found: list[ImportFinding] = []
    meta = trial.meta
    if 0 < meta.pressure_pa < PRESSURE_PA:
        found.append(
            ImportFinding(
                "refused", "pressure", f"pressure_pa is {meta.pressure_pa:g}: that is not in Pa",
                "give it in Pa: 6 PSI are 41370 Pa, 0.4 bar are 40000 Pa",
            )
        )  # fmt: skip
    return found


def _link_findings(trial: Trial) -> list[ImportFinding]:
    seen = link_direction(trial)
    angle = trial.angle_rad
    if seen is None or not np.isfinite(angle).all():
        return []
    kept = np.isfinite(seen).all(axis=1)
    seen, angle = seen[kept], angle[kept]
    moves = max(
        angle.std(axis=0).max(), pointing_angles_rad(seen)[:, : trial.meta.dof].std(axis=0).max()
    )
    if moves < LEAST_MOTION_RAD:
        return []
    rigid = base_rotation(angle)[:, :, 2]
    moved, due = (v[:, :2] - v[:, :2].mean(axis=0) for v in (seen, rigid))
    found = _reading(pointing_angles_rad(seen)[:, : trial.meta.dof], angle)
    if found:
        return found
    if trial.meta.dof == 1 and (one := _across(moved)) is not None:
        return [one]
    if not np.sum(due * due) > 0:
        return []  # the angles stand still
    along = np.sum(due * moved)
    across = np.sum(due[:, 0] * moved[:, 1] - due[:, 1] * moved[:, 0])
    yaw = float(np.arctan2(across, along))
    level = level_of(yaw, YAW_RAD)
    if level:
        return [
            ImportFinding(
                level, "yaw",
                f"the link moves {ANGLE.text(yaw)} beside the plane of joint 1",
                "correct yaw_deg under [frame], or the order of the corners",
            )
        ]  # fmt: skip
    gain = float(np.hypot(along, across) / np.sum(due * due))
    level = level_of(gain - 1, GAIN)
    if level:
        return [
            ImportFinding(
                level, "gain", f"the link turns {gain:.2f} times as far as the angle says",
                "check the angle's unit, the gear ratio and base_offset_m",
            )
        ]  # fmt: skip
    return []


def _across(moved: Array) -> ImportFinding | None:
    """Finding if the link of a single joint moves in a second direction."""
    sizes = np.sqrt(np.maximum(np.linalg.eigvalsh(moved.T @ moved), 0.0))
    across = float(sizes[0] / sizes[1]) if sizes[1] > 0 else 0.0
    level = level_of(across, ACROSS)
    if not level:
        return None
    return ImportFinding(
        level, "joints",
        f"the link moves in two directions, {across:.0%} across the plane of its only joint",
        "set dof = 2 and map the second servo, or hold the second joint still",
    )  # fmt: skip


def _reading(direction: Array, angle: Array) -> list[ImportFinding]:
    """Findings on signs and order of the joints, comparing each direction with each angle."""
    dof = angle.shape[1]
    fit = np.array(
        [[_correlation(direction[:, i], angle[:, j]) for j in range(dof)] for i in range(dof)]
    )
    found = [
        ImportFinding(
            "refused", "sign",
            f"joint {j + 1} counts the other way: its angle and the link's direction correlate by "
            f"{fit[j, j]:.2f}",
            f"set scale = -1.0 for angle_{j + 1}_rad and its goal, or mirror under [frame] for a "
            "left-handed file",
        )
        for j in range(dof)
        if fit[j, j] < -ALIKE
    ]  # fmt: skip
    if found or dof == 1:
        return found
    own, other = min(fit[0, 0], fit[1, 1]), min(abs(fit[0, 1]), abs(fit[1, 0]))
    if other > ALIKE and own < other - 0.1:
        return [
            ImportFinding(
                "refused", "joints", "joints 1 and 2 are swapped",
                "exchange them under [columns] or in 'joints' of MAP.toml",
            )
        ]  # fmt: skip
    return []


def _correlation(a: Array, b: Array) -> float:
    if min(a.std(), b.std()) < LEAST_MOTION_RAD:
        return 1.0
    return float(np.corrcoef(a, b)[0, 1])


def runs_against(goal_rad: Array, angle_rad: Array) -> bool:
    """Whether the angle (n,) of a joint mirrors its goal (n,): one of them has the wrong sign."""
    return _correlation(angle_rad, goal_rad) < -ALIKE


def _goal_findings(trial: Trial) -> list[ImportFinding]:
    found: list[ImportFinding] = []
    goal, angle = trial.goal_rad, trial.angle_rad
    for j in range(trial.meta.dof):
        q, g = angle[:, j], goal[:, j]
        if not np.isfinite(q).all() or min(q.std(), g.std()) < LEAST_MOTION_RAD:
            continue
        gain, against = float(q.std() / g.std()), runs_against(g, q)
        if against or not 0.3 < gain < 3.0:
            what = "run against each other" if against else f"differ by a factor of {gain:.3g}"
            found.append(
                ImportFinding(
                    "refused", "goal", f"goal and angle of joint {j + 1} {what}",
                    f"correct the sign or unit of goal_{j + 1}_rad",
                )
            )  # fmt: skip
    declared = trial.meta.amplitude_rad
    # A motion may begin away from zero, and a servo's zero may be elsewhere.
    reaches = (float(np.max(np.abs(goal - goal[0]))), float(np.max(np.abs(goal))))
    reach = min(reaches, key=lambda own: abs(own - declared))
    if reach > LEAST_MOTION_RAD and abs(reach - declared) > AMPLITUDE * max(reach, declared):
        found.append(
            ImportFinding(
                "warning", "amplitude",
                f"the goals reach {ANGLE.significant(reach)}, amplitude_rad says "
                f"{ANGLE.significant(declared)}",
                "correct amplitude_rad under [trial]",
            )
        )  # fmt: skip
    return found


def _current_findings(trial: Trial) -> list[ImportFinding]:
    """Findings on the sign of each current.

    Friction needs a current along the motion, the weight of an upright link one against its lean.
    Both must have the wrong sign before the current's sign counts as wrong.
    """
    found: list[ImportFinding] = []
    if trial.meta.dof == 2 and _exchanged_currents(trial):
        found.append(
            ImportFinding(
                "warning", "current", "currents 1 and 2 are swapped",
                "exchange their columns in MAP.toml",
            )
        )  # fmt: skip
    for j in range(trial.meta.dof):
        current, q = trial.current_a[:, j], trial.angle_rad[:, j]
        rate = np.gradient(q, trial.step_s)
        if not np.isfinite(current + q).all() or np.std(rate) < MOVING_RAD_S:
            continue
        terms, error = current_terms(current, q, trial.step_s)
        weight, friction = terms[1] * np.sin(q).std(), terms[2]
        noise = max(0.2 * error.std(), 0.1 * current.std())
        level: Level = "warning"
        if friction < -noise and weight > noise:
            found.append(
                ImportFinding(
                    level, "current",
                    f"current {j + 1} brakes where it should drive: its sign is turned",
                    f"set scale = -1.0 for current_{j + 1}_a",
                )
            )  # fmt: skip
    return found


def current_terms(current: Array, angle: Array, step_s: float) -> tuple[Array, Array]:
    """Fit a current by an offset, the sine of the angle (load) and the rate's sign (friction).

    `current` and `angle` have shape (n,). Returns the three coefficients in A, (3,), and the
    residual, (n,).
    """
    rate = np.gradient(angle, step_s)
    design = np.column_stack([np.ones_like(angle), np.sin(angle), np.tanh(rate / MOVING_RAD_S)])
    terms, *_ = np.linalg.lstsq(design, current, rcond=None)
    return terms, current - design @ terms


def _exchanged_currents(trial: Trial) -> bool:
    """Whether each current fits the other joint's motion better."""
    angle, current = trial.angle_rad, trial.current_a
    if not np.isfinite(angle + current).all() or angle.std(axis=0).min() < LEAST_MOTION_RAD:
        return False
    left = [
        [current_terms(current[:, i], angle[:, j], trial.step_s)[1].var() for j in (0, 1)]
        for i in (0, 1)
    ]
    return all(left[i][i] > SWAPPED * left[i][1 - i] for i in (0, 1))
