"""Findings on what is missing: mapped markers, gaps in time, occlusions, rest rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from firmware_py.display_units import LENGTH
from models.trials.importers.mapping import RecordingMap
from models.trials.importers.series import Series
from models.trials.trial import Array, Trial
from models.trials.verdict.finding import (
    GAP_S,
    REST_MOVE_M,
    REST_ROWS,
    UNSEEN,
    ImportFinding,
    level_of,
)


@dataclass(frozen=True)
class Gap:
    """Longest time without a sample in a series."""

    file: str  # Name of the file
    start_s: float  # Last sample before the gap, on the trial's clock
    length_s: float  # Time to the next sample
    step_s: float  # Usual step of the series


def longest_gaps(series: Sequence[Series], start_s: float, end_s: float) -> list[Gap]:
    """Longest gap of every series between the first and the last time of a trial."""
    gaps = []
    for s in series:
        inside = s.time_s[(s.time_s >= start_s - 1.0) & (s.time_s <= end_s + 1.0)]
        if len(inside) < 2:
            continue
        steps = np.diff(inside)
        k = int(np.argmax(steps))
        gaps.append(
            Gap(s.path.name, float(inside[k] - start_s), float(steps[k]), float(np.median(steps)))
        )
    return gaps


def judge_gaps(gaps: Sequence[Gap]) -> list[ImportFinding]:
    """Findings on gaps that would be bridged by interpolation."""
    found = []
    for gap in gaps:
        bridged_s = gap.length_s if gap.length_s > 1.5 * gap.step_s else 0.0
        level = level_of(bridged_s, GAP_S)
        if level:
            found.append(
                ImportFinding(
                    level, "gap",
                    f"{gap.file} has no samples for {gap.length_s:.3f} s from "
                    f"{gap.start_s:.2f} s on",
                    "cut the recording there, or record it again",
                )
            )  # fmt: skip
    return found


def judge_markers(series: Sequence[Series], mapping: RecordingMap) -> list[ImportFinding]:
    """Findings on markers that are mapped but absent, or occluded most of the time."""
    columns = {name: values for s in series for name, values in s.columns.items()}
    markers = mapping.layout.names
    given = [n for n in (*markers, "tip") if f"{n}_x_m" in columns]
    if not given:
        return []
    found = []
    for name, source in mapping.markers.items():
        if f"{name}_x_m" not in columns:
            found.append(
                ImportFinding(
                    "refused", "absent",
                    f"{name} is mapped to {source!r}, which the file does not hold",
                    "correct [markers] in MAP.toml",
                )
            )  # fmt: skip
    missing = [n for n in markers if n not in given and n not in mapping.markers]
    if missing and set(given) != {"tip"}:
        found.append(
            ImportFinding(
                "warning", "absent",
                f"the file holds no {', '.join(missing)}: there is no Deformation Index without",
                "map them under [markers], or use the plant without DI",
            )
        )  # fmt: skip
    for name in given:
        unseen = float(np.mean(~np.isfinite(columns[f"{name}_x_m"])))
        level = level_of(unseen, UNSEEN)
        if level:
            found.append(
                ImportFinding(
                    level, "occluded", f"{name} is unseen in {unseen:.0%} of the rows",
                    "check its name, or record it again with the marker in view",
                )
            )  # fmt: skip
    return found


def judge_rest(trial: Trial) -> list[ImportFinding]:
    """Findings on the rest rows of a trial with markers."""
    markers_m = trial.markers_m
    if not np.isfinite(markers_m).any():
        return []
    rest = trial.meta.rest_samples
    if rest < REST_ROWS[0]:
        return [
            ImportFinding(
                "refused" if rest < REST_ROWS[1] else "warning", "rest",
                f"{rest} row{'' if rest == 1 else 's'} at rest before the motion, the reference of "
                "the Deformation Index",
                f"start both recordings at least {REST_ROWS[0]} rows before the motion",
            )
        ]  # fmt: skip
    moved = _largest_move_m(markers_m[:rest])
    level = level_of(moved, REST_MOVE_M)
    if level:
        return [
            ImportFinding(
                level, "rest",
                f"a marker moves by {LENGTH.text(moved)} within the {rest} rest rows",
                "correct rest_samples, or let the link come to rest first",
            )
        ]  # fmt: skip
    return []


def _largest_move_m(markers_m: Array) -> float:
    """Largest distance between a marker's mean places in the first and the last third of rows."""
    third = max(len(markers_m) // 3, 1)
    ends = []
    for rows in (markers_m[:third], markers_m[-third:]):
        seen = np.isfinite(rows)
        count = seen.sum(axis=0)
        ends.append(
            np.where(
                count > 0, np.where(seen, rows, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan
            )
        )
    moved = np.linalg.norm(ends[1] - ends[0], axis=-1)
    return float(np.nanmax(moved)) if np.isfinite(moved).any() else 0.0
