"""Tip: its distance from the centre of the last marker row, its reach, and single jumps.

The tip is defined as the centre of the last marker row (docs/trials.md). A recording may use its
name for another point: in Motive the pivot of a rigid body may be anywhere, and an asset may be the
wrong one.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.units import LENGTH
from models.shared.kinematics import base_rotation
from models.trials.checks import causes
from models.trials.checks.causes import ImportFinding, at_rows
from models.trials.checks.pose import unit_of_length
from models.trials.checks.signals import single_samples
from models.trials.recordings.series import row_centre_m
from models.trials.trial import Array, Trial

Rows = NDArray[np.intp]

WARNED_M, REFUSED_M = causes.TIP_PLACE.limits
REACH: Final = (0.5, 1.3)
"""Distance of the tip from the joint axes, relative to a straight link's: a link bent to a half
circle has 0.64; a larger distance means another unit or origin."""
JUMP_M: Final = 0.02
"""Smallest distance from the middle of the adjacent samples at which the tip jumps."""
SAME_PLACE_M: Final = 1e-3
"""Largest distance between points at the same place."""


def judge_tip(trial: Trial) -> list[ImportFinding]:
    """Findings on the tip of a trial of the link.

    It is compared with the centre of the last marker row where that is visible, and with the reach
    of the link. A trial without a tip, or of another plant, has no findings.
    """
    if not trial.meta.link_length_m or "tip_x_m" not in trial.columns:
        return []
    visible = np.flatnonzero(np.isfinite(trial.tip_m).all(axis=1))
    if not len(visible):
        return []
    reach_m = trial.meta.base_offset_m + trial.meta.link_length_m
    size_m = float(np.median(np.linalg.norm(trial.tip_m[visible], axis=1)))
    rows, apart_m = _from_last_row(trial)
    is_marker = len(rows) > 0 and _marker_at(trial, rows) != ""
    if not REACH[0] <= size_m / reach_m <= REACH[1] and not is_marker:
        unit = unit_of_length(size_m / reach_m)
        return causes.TIP_REACH.raised(size_m=size_m, reach_m=reach_m, unit=unit)
    names = trial.meta.layout.row(-1)
    row = names[0] if len(names) == 1 else f"{names[0]} to {names[-1]}"
    findings: list[ImportFinding] = []
    if len(rows):
        off_m = np.linalg.norm(apart_m, axis=1)
        usual_m = float(np.median(off_m))
        findings += causes.TIP_PLACE.beyond(usual_m, row=row, cause=_cause(trial, rows, apart_m))
        if usual_m <= REFUSED_M:
            part = float(np.mean(off_m > REFUSED_M))
            findings += causes.TIP_PART.beyond(part, limit_m=REFUSED_M, row=row)
        if any(f.level == "refused" for f in findings):
            return findings
        wrong = rows[off_m > usual_m + REFUSED_M]
        if len(wrong):
            where = at_rows(wrong, trial.time_s)
            findings += causes.TIP_ROWS.raised(off_m=off_m.max(), where=where, row=row)
    tip_m = trial.tip_m[visible]
    beyond = np.flatnonzero(np.linalg.norm(tip_m, axis=1) > REACH[1] * reach_m)
    jumps = np.setdiff1d(visible[np.union1d(beyond, single_samples(tip_m, JUMP_M))], rows)
    if len(jumps):
        findings += causes.TIP_JUMPS.raised(where=at_rows(jumps, trial.time_s), row=row)
    return findings


def _from_last_row(trial: Trial) -> tuple[Rows, Array]:
    """Rows in which the last marker row is valid, and the tip's place from its centre.

    It is valid if three of its markers are visible, or all of fewer, and no distance within it has
    changed by a centimetre.
    """
    none = np.empty(0, dtype=np.intp), np.empty((0, 3))
    layout = trial.meta.layout
    if f"{layout.names[-1]}_x_m" not in trial.columns:
        return none
    row_m = trial.marker_rows_m[:, -1]
    first, second = np.triu_indices(layout.corners, 1)
    distance_m = np.linalg.norm(row_m[:, first] - row_m[:, second], axis=2)
    known = np.isfinite(distance_m).any(axis=0)
    usual_m = np.zeros(len(first))
    usual_m[known] = np.nanmedian(distance_m[:, known], axis=0)
    if len(first) and usual_m.max() < SAME_PLACE_M:
        return none  # all in one place, so these are no markers
    changed_m = np.nan_to_num(np.abs(distance_m - usual_m)).max(axis=1, initial=0.0)
    apart_m = trial.tip_m - row_centre_m(row_m, layout)
    count = np.isfinite(row_m).all(axis=2).sum(axis=1)
    valid = (count >= min(3, layout.corners)) & (changed_m < 0.01)
    rows = np.flatnonzero(valid & np.isfinite(apart_m).all(axis=1))
    return rows, apart_m[rows]


TURNED: Final = (
    ("x is negated", (0, 1, 2), (-1, 1, 1)),
    ("y is negated", (0, 1, 2), (1, -1, 1)),
    ("z is negated", (0, 1, 2), (1, 1, -1)),
    ("x and y are exchanged", (1, 0, 2), (1, 1, 1)),
    ("x and z are exchanged", (2, 1, 0), (1, 1, 1)),
    ("y and z are exchanged", (0, 2, 1), (1, 1, 1)),
)
"""Mistakes in the axes of the tip: order and signs that undo them."""
CONSTANT: Final = 0.1
"""Largest change of a constant offset, relative to its length."""


def _cause(trial: Trial, rows: Rows, apart_m: Array) -> str:
    """Probable cause of the tip's distance, in words."""
    tip_m, off_m = trial.tip_m[rows], float(np.median(np.linalg.norm(apart_m, axis=1)))
    marker = _marker_at(trial, rows)
    if marker:
        return f": it is marker {marker}"
    for words, order, signs in TURNED:
        remaining_m = tip_m[:, order] * signs - (tip_m - apart_m)
        if np.median(np.linalg.norm(remaining_m, axis=1)) < min(WARNED_M, CONSTANT * off_m):
            return f": {words}"
    in_link_m = np.einsum("nji,nj->ni", base_rotation(trial.angle_rad[rows]), apart_m)
    for frame, offset_m in (("link", in_link_m), ("world", apart_m)):
        middle_m = np.median(offset_m, axis=0)
        change_m = float(np.median(np.linalg.norm(offset_m - middle_m, axis=1)))
        if change_m < max(CONSTANT * float(np.linalg.norm(middle_m)), SAME_PLACE_M):
            listed = ", ".join(f"{LENGTH.factor * v:+.0f}" for v in middle_m)
            return f", by dx, dy, dz = {listed} {LENGTH.name} in the frame of the {frame}"
    return ", by no constant offset: an axis, a unit or a point is wrong"


def _marker_at(trial: Trial, rows: Rows) -> str:
    """Name of the marker at the tip's place, empty for none."""
    for name, marker_m in zip(
        trial.meta.layout.names, trial.markers_m[rows].swapaxes(0, 1), strict=True
    ):
        distance_m = np.linalg.norm(marker_m - trial.tip_m[rows], axis=1)
        visible_m = distance_m[np.isfinite(distance_m)]
        if len(visible_m) and np.median(visible_m) < SAME_PLACE_M:
            return name
    return ""
