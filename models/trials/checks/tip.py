"""Tip: its distance from the centre of the last marker row, its reach, and single jumps.

The tip is defined as the centre of the last marker row (docs/trials.md). A recording may use its
name for another point: in Motive the pivot of a rigid body may be anywhere, and an asset may be the
wrong one.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.display_units import LENGTH
from models.shared.kinematics import base_rotation
from models.trials.checks import causes
from models.trials.checks.causes import ImportFinding
from models.trials.checks.pose import unit_of_length
from models.trials.recordings.series import row_centre_m
from models.trials.trial import Array, Trial

Rows = NDArray[np.intp]

BESIDE_M: Final = causes.TIP_PLACE.limits
REFUSED_ROWS: Final = 0.1
"""Fraction of rows above which a tip beyond the limit is more than outliers [assumed]."""
ROW_SHAPE_M: Final = 0.01
"""Change of a distance within the last row above which its centre is not used in a sample."""
FEWEST_SEEN: Final = 3
"""Fewest visible markers of a row, or all of a smaller row."""
REACH: Final = (0.5, 1.3)
"""Distance of the tip from the joint axes, relative to a straight link's: a link bent to a half
circle has 0.64; a larger distance means another unit or origin."""
CONSTANT: Final = 0.1
"""Largest change of a constant offset, relative to its length."""
SAME_PLACE_M: Final = 1e-3
"""Largest distance between tip and marker at the same place."""
JUMP_M: Final = 0.02
"""Smallest distance from the midpoint of the adjacent samples at which the tip jumps."""
JUMP_NOISE: Final = 20.0
"""Smallest jump, relative to the median of that distance."""
TURNED: Final = (
    ("x is negated", (0, 1, 2), (-1, 1, 1)),
    ("y is negated", (0, 1, 2), (1, -1, 1)),
    ("z is negated", (0, 1, 2), (1, 1, -1)),
    ("x and y are exchanged", (1, 0, 2), (1, 1, 1)),
    ("x and z are exchanged", (2, 1, 0), (1, 1, 1)),
    ("y and z are exchanged", (0, 2, 1), (1, 1, 1)),
)
"""Mistakes in the axes of the tip: order and signs that undo them."""


def judge_tip(trial: Trial) -> list[ImportFinding]:
    """Findings on the tip of a trial of the link.

    It is compared with the centre of the last marker row where that is visible, and with the reach
    of the link. A trial without a tip, or of another plant, has no findings.
    """
    if not trial.meta.link_length_m or "tip_x_m" not in trial.columns:
        return []
    seen = np.flatnonzero(np.isfinite(trial.tip_m).all(axis=1))
    if not len(seen):
        return []
    reach_m = trial.meta.base_offset_m + trial.meta.link_length_m
    size_m = float(np.median(np.linalg.norm(trial.tip_m[seen], axis=1)))
    rows, apart_m = _from_last_row(trial)
    if not REACH[0] <= size_m / reach_m <= REACH[1] and not _marker_at(trial, rows):
        unit = unit_of_length(size_m / reach_m)
        return causes.TIP_REACH.raised(size_m=size_m, reach_m=reach_m, unit=unit)
    off_m = np.linalg.norm(apart_m, axis=1)
    found = _beside_row(trial, rows, apart_m) if len(rows) else []
    if any(f.level == "refused" for f in found):
        return found
    usual_m = float(np.median(off_m)) if len(rows) else 0.0
    wrong = rows[off_m > usual_m + BESIDE_M[1]]
    if len(wrong):
        off = LENGTH.text(off_m.max(), 0)
        what = f"up to {off} from the centre of {_last_row(trial)}"
        found += causes.TIP_ROWS.raised(what=what, where=_where(trial, wrong), row=_last_row(trial))
    others = np.setdiff1d(_jumps(trial, seen, reach_m), rows)
    if len(others):
        where = _where(trial, others)
        found += causes.TIP_ROWS.raised(what="off its course", where=where, row=_last_row(trial))
    return found


def _from_last_row(trial: Trial) -> tuple[Rows, Array]:
    """Rows in which the last marker row is valid, and the tip's place from its centre."""
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
    changed = np.nan_to_num(np.abs(distance_m - usual_m)).max(axis=1, initial=0.0)
    apart_m = trial.tip_m - row_centre_m(np.moveaxis(row_m, 1, 0), layout.corners_m)
    count = np.isfinite(row_m).all(axis=2).sum(axis=1)
    kept = (count >= min(FEWEST_SEEN, layout.corners)) & (changed < ROW_SHAPE_M)
    rows = np.flatnonzero(kept & np.isfinite(apart_m).all(axis=1))
    return rows, apart_m[rows]


def _beside_row(trial: Trial, rows: Rows, apart_m: Array) -> list[ImportFinding]:
    """Finding on a tip that is not the centre of the last marker row in the whole run."""
    off_m = np.linalg.norm(apart_m, axis=1)
    usual_m, most_m = float(np.median(off_m)), float(np.quantile(off_m, 1 - REFUSED_ROWS))
    level = "refused" if most_m > BESIDE_M[1] else causes.TIP_PLACE.level(usual_m)
    if level is None:
        return []
    off, cause = LENGTH.text(usual_m), _cause(trial, rows, apart_m)
    if usual_m <= BESIDE_M[0]:
        part = float(np.mean(off_m > BESIDE_M[1]))
        off, cause = f"beyond {LENGTH.text(BESIDE_M[1], 0)}", f" in {part:.0%} of the rows"
    return [causes.TIP_PLACE.at(level, off=off, row=_last_row(trial), cause=cause)]


def _cause(trial: Trial, rows: Rows, apart_m: Array) -> str:
    """Probable cause of the tip's distance, in words."""
    tip_m, off_m = trial.tip_m[rows], float(np.median(np.linalg.norm(apart_m, axis=1)))
    marker = _marker_at(trial, rows)
    if marker:
        return f": it is marker {marker}"
    for words, order, signs in TURNED:
        left_m = tip_m[:, order] * signs - (tip_m - apart_m)
        if np.median(np.linalg.norm(left_m, axis=1)) < min(BESIDE_M[0], CONSTANT * off_m):
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
    if not len(rows):
        return ""
    distance_m = np.linalg.norm(trial.markers_m[rows] - trial.tip_m[rows, None], axis=2)
    for name, own_m in zip(trial.meta.layout.names, distance_m.T, strict=True):
        known_m = own_m[np.isfinite(own_m)]
        if len(known_m) and np.median(known_m) < SAME_PLACE_M:
            return name
    return ""


def _jumps(trial: Trial, seen: Rows, reach_m: float) -> Rows:
    """Rows in which the tip jumps from the adjacent samples, or leaves the reach of the link."""
    tip_m = trial.tip_m[seen]
    beyond = np.linalg.norm(tip_m, axis=1) > REACH[1] * reach_m
    if len(seen) >= 3:
        bent_m = np.linalg.norm(tip_m[1:-1] - 0.5 * (tip_m[:-2] + tip_m[2:]), axis=1)
        limit_m = max(JUMP_M, JUMP_NOISE * float(np.median(bent_m)))
        around_m = np.linalg.norm(tip_m[2:] - tip_m[:-2], axis=1)
        beyond[1:-1] |= (bent_m > limit_m) & (bent_m > around_m)
    return np.asarray(seen[beyond])


def _last_row(trial: Trial) -> str:
    names = trial.meta.layout.row(-1)
    return names[0] if len(names) == 1 else f"{names[0]} to {names[-1]}"


def _where(trial: Trial, rows: Rows) -> str:
    """Single rows, counted as in the trial's file: its header is row 1."""
    where = f"row {rows[0] + 2} ({trial.time_s[rows[0]]:.2f} s)"
    return f"{len(rows)} rows from {where} on" if len(rows) > 1 else where
