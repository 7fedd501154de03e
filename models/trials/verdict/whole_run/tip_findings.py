"""Findings on the tip: its distance from the centre of the last marker row, and single jumps.

The tip is defined as the centre of the last marker row (docs/trials.md). A recording may use its
name for another point: in Motive the pivot of a rigid body may be anywhere, and an asset may be the
wrong one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.display_units import LENGTH
from models.shared.kinematics import base_rotation
from models.trials.importers.series import row_centre_m
from models.trials.trial import Array, Trial
from models.trials.verdict.finding import SHAPE_M, ImportFinding, level_of

REFUSED_ROWS: Final = 0.1
"""Fraction of rows above which a tip beyond the limit is more than outliers [assumed]."""
ROW_SHAPE_M: Final = 0.01
"""Change of a distance within the last row above which its centre is not used in a sample."""
FEWEST_SEEN: Final = 3
"""Fewest visible markers of a row, or all of a smaller row."""
REACH: Final = (0.5, 1.3)
"""Distance of the tip from the joint axes, relative to a straight link's: a link bent to a half
circle has 0.64; a larger distance means another unit or origin."""
UNITS: Final = (("mm", 1e3), ("cm", 1e2), ("inches", 39.37), ("feet", 3.281), ("km", 1e-3))
"""Units in which a tip may be, and how many of them are 1 m."""
SAME_UNIT: Final = 0.05
"""Largest relative error of the distance from the joint axes at which a unit is recognised."""
CONSTANT: Final = 0.1
"""Largest change of a constant offset, relative to its length."""
SAME_PLACE_M: Final = 1e-3
"""Largest distance between tip and marker at the same place."""
JUMP_M: Final = 0.02
"""Smallest distance from the midpoint of the adjacent samples at which the tip jumps."""
JUMP_NOISE: Final = 20.0
"""Smallest jump, relative to the median of that distance."""
_TURNED: Final = (
    ("x is negated", (0, 1, 2), (-1, 1, 1)),
    ("y is negated", (0, 1, 2), (1, -1, 1)),
    ("z is negated", (0, 1, 2), (1, 1, -1)),
    ("x and y are exchanged", (1, 0, 2), (1, 1, 1)),
    ("x and z are exchanged", (2, 1, 0), (1, 1, 1)),
    ("y and z are exchanged", (0, 2, 1), (1, 1, 1)),
)
"""Mistakes in the axes of the tip: order and signs that undo them."""

Rows = NDArray[np.intp]


def judge_tip(trial: Trial) -> list[ImportFinding]:
    """Findings on the tip of a trial of the link.

    It is compared with the centre of the last marker row where that is visible, and with the reach
    of the link. A trial without a tip, or of another plant, has no findings.
    """
    if not trial.meta.link_length_m or "tip_x_m" not in trial.columns:
        return []
    tip_m = trial.tip_m
    seen = np.flatnonzero(np.isfinite(tip_m).all(axis=1))
    if not len(seen):
        return []
    rows, apart_m = _apart(trial)
    found = _reach(trial, tip_m[seen])
    if found and not _marker_at(trial, rows):
        return found
    off_m = np.linalg.norm(apart_m, axis=1)
    found = _beside_row(trial, rows, apart_m) if len(rows) else []
    if any(f.level == "refused" for f in found):
        return found
    usual_m = float(np.median(off_m)) if len(rows) else 0.0
    wrong = rows[off_m > usual_m + SHAPE_M[1]]
    others = np.setdiff1d(_jumps(trial, seen), rows)
    if len(wrong):
        off = LENGTH.text(off_m.max(), 0)
        found.append(_at_rows(trial, wrong, f"up to {off} from the centre of {_row_name(trial)}"))
    if len(others):
        found.append(_at_rows(trial, others, "off its course"))
    return found


def _reach(trial: Trial, tip_m: Array) -> list[ImportFinding]:
    """Finding on a tip far from the link."""
    reach_m = trial.meta.base_offset_m + trial.meta.link_length_m
    size_m = float(np.median(np.linalg.norm(tip_m, axis=1)))
    low, high = REACH
    if low * reach_m <= size_m <= high * reach_m:
        return []
    units = [
        unit for unit, per_m in UNITS if abs(size_m / (per_m * reach_m) - 1) < SAME_UNIT
    ]  # fmt: skip
    cause = f": it is in {units[0]}" if units else ""
    return [
        ImportFinding(
            "refused", "tip",
            f"the tip is {size_m:.3g} m from the joint axes, the end of the link "
            f"{reach_m:.3g} m{cause}",
            "correct the unit or place of tip (tip_x_m, tip_y_m, tip_z_m), or link_length_m",
        )
    ]  # fmt: skip


def _apart(trial: Trial) -> tuple[Rows, Array]:
    """Rows in which the last marker row is valid, and the tip's place from its centre."""
    none = np.empty(0, dtype=np.intp), np.empty((0, 3))
    layout = trial.meta.layout
    if f"{layout.names[-1]}_x_m" not in trial.columns:
        return none
    row_m = trial.marker_rows_m[:, -1]
    first, second = np.triu_indices(layout.corners, 1)
    distance_m = np.linalg.norm(row_m[:, first] - row_m[:, second], axis=2)
    seen = np.isfinite(row_m).all(axis=2)
    known = np.isfinite(distance_m).any(axis=0)
    usual_m = np.zeros(len(first))
    usual_m[known] = np.nanmedian(distance_m[:, known], axis=0)
    if len(first) and usual_m.max() < SAME_PLACE_M:
        return none  # all in one place, so these are no markers
    changed = np.nan_to_num(np.abs(distance_m - usual_m)).max(axis=1, initial=0.0)
    apart_m = trial.tip_m - row_centre_m(np.moveaxis(row_m, 1, 0), layout.corners_m)
    kept = (seen.sum(axis=1) >= min(FEWEST_SEEN, layout.corners)) & (changed < ROW_SHAPE_M)
    rows = np.flatnonzero(kept & np.isfinite(apart_m).all(axis=1))
    return rows, apart_m[rows]


def _beside_row(trial: Trial, rows: Rows, apart_m: Array) -> list[ImportFinding]:
    """Finding on a tip that is not the centre of the last marker row in the whole run."""
    off_m = np.linalg.norm(apart_m, axis=1)
    usual_m, most_m = float(np.median(off_m)), float(np.quantile(off_m, 1 - REFUSED_ROWS))
    level = "refused" if most_m > SHAPE_M[1] else level_of(usual_m, SHAPE_M)
    if level is None:
        return []
    where = f"from the centre of the last marker row ({_row_name(trial)})"
    if usual_m > SHAPE_M[0]:
        text = f"the tip is {LENGTH.text(usual_m)} {where}{_cause(trial, rows, apart_m)}"
    else:
        part = float(np.mean(off_m > SHAPE_M[1]))
        text = f"the tip is beyond {LENGTH.text(SHAPE_M[1], 0)} {where} in {part:.0%} of the rows"
    return [
        ImportFinding(
            level, "tip", text,
            "correct tip in [markers] of the map (the pivot of its rigid body), or leave it out to "
            "have it computed, and import again",
        )
    ]  # fmt: skip


def _cause(trial: Trial, rows: Rows, apart_m: Array) -> str:
    """Probable cause of the tip's distance, in words."""
    tip_m, off_m = trial.tip_m[rows], np.linalg.norm(apart_m, axis=1)
    marker = _marker_at(trial, rows)
    if marker:
        return f": it is marker {marker}"
    for words, order, signs in _TURNED:
        left_m = tip_m[:, order] * signs - (tip_m - apart_m)
        if np.median(np.linalg.norm(left_m, axis=1)) < min(SHAPE_M[0], CONSTANT * np.median(off_m)):
            return f": {words}"
    turn = base_rotation(trial.angle_rad[rows])
    for frame, offset_m in (
        ("link", np.einsum("nji,nj->ni", turn, apart_m)), ("world", apart_m),
    ):  # fmt: skip
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


def _jumps(trial: Trial, seen: Rows) -> Rows:
    """Rows in which the tip jumps from the adjacent samples, or leaves the reach of the link."""
    tip_m = trial.tip_m[seen]
    reach_m = trial.meta.base_offset_m + trial.meta.link_length_m
    beyond = np.linalg.norm(tip_m, axis=1) > REACH[1] * reach_m
    if len(seen) >= 3:
        middle_m = 0.5 * (tip_m[:-2] + tip_m[2:])
        bent_m = np.linalg.norm(tip_m[1:-1] - middle_m, axis=1)
        limit_m = max(JUMP_M, JUMP_NOISE * float(np.median(bent_m)))
        around_m = np.linalg.norm(tip_m[2:] - tip_m[:-2], axis=1)
        beyond[1:-1] |= (bent_m > limit_m) & (bent_m > around_m)
    return np.asarray(seen[beyond])


def _row_name(trial: Trial) -> str:
    names: Sequence[str] = trial.meta.layout.row(-1)
    return names[0] if len(names) == 1 else f"{names[0]} to {names[-1]}"


def _at_rows(trial: Trial, rows: Rows, what: str) -> ImportFinding:
    """Warning on single rows, counted as in the trial's file: its header is row 1."""
    first = int(rows[0])
    where = f"row {first + 2} ({trial.time_s[first]:.2f} s)"
    if len(rows) > 1:
        where = f"{len(rows)} rows from {where} on"
    return ImportFinding(
        "warning", "tip", f"the tip is {what} in {where}",
        f"correct the tip there: the centre of {_row_name(trial)}, or interpolate it",
    )  # fmt: skip
