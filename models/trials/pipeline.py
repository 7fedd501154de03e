"""Check of an earlier import: which recording the trial to be replaced came from.

An imported trial stores the hash of its recording (`TrialMeta.recording_sha256`). You may import
the same recording again, for example with another map. A trial of another recording, or a file
that is no trial, is never replaced.

Import of one recording with every check: read, judged, aligned, synchronised, assembled.
"""

from __future__ import annotations

import hashlib
import os
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from firmware_py.errors import InputError
from firmware_py.files.input_files import open_bounded, read_toml
from models.trials.checks.base import judge_base_offset, judge_fixed_base
from models.trials.checks.clocks import (
    judge_clock,
    judge_common_clock,
    judge_frame_rate,
    judge_given_offset,
)
from models.trials.checks.markers import judge_markers, without_zeros
from models.trials.checks.payloads import judge_conditions
from models.trials.checks.pose import RestPose, judge_base, judge_pose, rest_pose
from models.trials.checks.signals import (
    judge_gaps,
    judge_goal_sources,
    judge_shared_signals,
    judge_signals,
    judge_steps,
    judge_times,
    longest_gaps,
)
from models.trials.checks.trials import judge_whole
from models.trials.checks.verdict import ImportVerdict
from models.trials.clock import (
    Synchronisation,
    UnlikeMotionsError,
    offset_near,
    shift_clock,
    synchronise,
    without_sync,
)
from models.trials.recordings import read_series
from models.trials.recordings.assembly import align_markers, assemble_trial, rest_count
from models.trials.recordings.frame import to_world
from models.trials.recordings.mapping import BASE_MARKERS, RecordingMap
from models.trials.recordings.series import Series, marker_columns
from models.trials.trial import Array, Trial

_MOST_FILES: Final = 1000
"""Most files of a folder that are hashed; the reader of bags accepts fewer."""
_PART_BYTES: Final = 1 << 20
_REMEDY: Final = "give another --out, or move it away"


def recording_hash(path: Path) -> str:
    """SHA-256 of a recording; for a folder (a ROS 2 bag), over its files in order of name."""
    is_bag = path.is_dir()
    files = sorted(islice(path.iterdir(), _MOST_FILES)) if is_bag else [path]
    digest = hashlib.sha256()
    for file in files:
        if is_bag:
            digest.update(b"\0" + file.name.encode("utf-8", "surrogateescape") + b"\0")
        with open_bounded(file, "name an existing file") as stream:
            while part := stream.read(_PART_BYTES):
                digest.update(part)
    return digest.hexdigest()


def check_earlier_import(directory: Path, name: str, recording_sha256: str) -> None:
    """Refuse to replace a trial of another recording, or files that are no trial."""
    samples, conditions = directory / f"{name}.csv", directory / f"{name}.toml"
    there = [path for path in (samples, conditions) if os.path.lexists(path)]
    if not there:
        return
    try:
        document = read_toml(conditions)
    except InputError:
        document = {}
    known = document.get("recording_sha256")
    if known is None:
        raise InputError(there[0], "would be replaced, and is no imported trial", _REMEDY)
    if known != recording_sha256:
        raise InputError(there[0], "is a trial of another recording", _REMEDY)


_UP: Final = {"motive": "y"}
"""Upward axis by format; z in all other formats."""
_EPOCH_FROM_S: Final = 1e6
"""First time of a clock above which it counts from an epoch: twelve days."""
_LOST_DIGITS_S: Final = 2e-6
"""Rounding error of a time since 1970 as a double, including a conversion of its unit."""


class Source(NamedTuple):
    """Files and options of one import."""

    file: Path  # Recording
    kind: str  # Format of the recording
    servo: Path | None = None  # Second file with the servo's signals
    offset_s: float | None = None  # Offset of the servo's clock; None to estimate it


def inspect_import(source: Source, mapping: RecordingMap, verdict: ImportVerdict) -> Trial:
    """Import a recording and collect its verdict."""
    series = read_series(source.file, source.kind, mapping)
    if source.kind == "table":
        series = [_table_to_world(s, mapping) for s in series]
    servo = read_series(source.servo, None, mapping.for_servo()) if source.servo else []
    epoch_s, servo_epoch_s = _epoch_s(series), _epoch_s(servo)
    series, servo = _since(series, epoch_s), _since(servo, servo_epoch_s)
    link = not mapping.signals
    if link:
        series = _without_zeros(series, mapping, verdict)
        verdict.findings += [*judge_markers(series, mapping), *judge_goal_sources(mapping)]
        for side in filter(None, (servo, series)):
            verdict.findings += [*judge_times(side), *judge_signals(side, mapping.dof)]
        verdict.findings += judge_fixed_base(series, mapping.meta(0))
        rest_rad = _first_angles([*servo, *series], mapping.dof)
        series = _aligned(series, mapping, verdict, rest_rad, source)
    for side in (servo, series):
        verdict.findings += judge_steps(side, mapping)
    if servo:
        series = _merged(servo, series, source, mapping, verdict, epoch_s - servo_epoch_s)
    elif link:
        remedy = "give the angles as a second file with --servo"
        verdict.clock, late = judge_common_clock(series, mapping.meta(0), remedy)
        verdict.findings += late
    if link:
        verdict.findings += judge_base_offset(series, mapping.meta(0))
    series = without_sync(_without_base(series))
    verdict.steps_s = {s.path.name: float(np.median(np.diff(s.time_s))) for s in series}
    start_s = max(s.time_s[0] for s in series)
    verdict.gaps = longest_gaps(series, start_s, min(s.time_s[-1] for s in series))
    verdict.findings += judge_gaps(verdict.gaps)
    if servo and not verdict.refused:
        verdict.findings += judge_clock(verdict.clock) if verdict.clock else []
        if verdict.refused:
            drifts = bool(verdict.clock and verdict.clock.drifts)
            _judge_whole_files(servo, series[: -len(servo)], mapping, verdict, drifts)
    verdict.refuse(source.file)
    trial = assemble_trial(series, mapping, verdict.name)
    verdict.trial = trial
    if link:
        verdict.findings += judge_conditions(trial, is_described=bool(mapping.link))
        verdict.findings += judge_whole(trial)
    verdict.refuse(source.file)
    return trial


def _merged(
    servo: list[Series],
    series: list[Series],
    source: Source,
    mapping: RecordingMap,
    verdict: ImportVerdict,
    apart_s: float,
) -> list[Series]:
    """Series of both files on one clock; their epochs are `apart_s` apart."""
    try:
        clock = _clock(servo, series, source, mapping, verdict, apart_s)
    except InputError as error:
        unlike = isinstance(error, UnlikeMotionsError)
        _judge_whole_files(servo, series, mapping, verdict, unlike)
        verdict.refuse(source.file)
        raise
    servo = shift_clock(servo, clock.offset_s)
    verdict.findings += judge_shared_signals(without_sync(servo), without_sync(series))
    second_s = clock.second_offset_s + apart_s
    verdict.clock = replace(clock, offset_s=clock.offset_s + apart_s, second_offset_s=second_s)
    return [*series, *servo]


def _judge_whole_files(
    servo: list[Series],
    mocap: list[Series],
    mapping: RecordingMap,
    verdict: ImportVerdict,
    may_be_rate: bool,
) -> None:
    """Put in front why the clocks of two files may not fit: a gap in one of them, or its rate."""
    gaps = [
        gap for side in (servo, mocap)
        for gap in longest_gaps(side, side[0].time_s[0], side[0].time_s[-1])
    ]  # fmt: skip
    verdict.gaps = gaps
    found = judge_gaps(gaps)
    if may_be_rate and not mapping.signals:
        found = found or judge_frame_rate(servo, mocap, mapping.meta(0))
    verdict.findings[:0] = found


def _table_to_world(series: Series, mapping: RecordingMap) -> Series:
    """Transform the markers of a table to the world frame; other readers do it themselves."""
    names = [n for n in mapping.known_markers if _has(series, n)]
    frame = mapping.frame
    moved = frame.up not in (None, "z") or frame.yaw_deg or any(frame.origin_m) or frame.mirror
    if not names or not moved:
        return series
    world_m = to_world({n: series.position_m(n) for n in names}, mapping.frame, "z")
    return Series(series.time_s, series.columns | marker_columns(world_m), series.path)


def _without_zeros(
    series: list[Series], mapping: RecordingMap, verdict: ImportVerdict
) -> list[Series]:
    """Remove samples of markers at the file's zero from series in the world frame."""
    zero_m = to_world({"zero": np.zeros((1, 3))}, mapping.frame, "z")["zero"][0]
    remedy = "check that these markers were hidden: the samples are left out"
    series, found = without_zeros(series, mapping.known_markers, zero_m, remedy)
    verdict.findings += found
    return series


def _has(series: Series, name: str) -> bool:
    return all(f"{name}_{axis}_m" in series.columns for axis in "xyz")


def _without_base(series: list[Series]) -> list[Series]:
    """Remove the base's markers, which are not signals of a trial."""
    drop = {f"{name}_{axis}_m" for name in BASE_MARKERS for axis in "xyz"}
    return [
        Series(s.time_s, {n: v for n, v in s.columns.items() if n not in drop}, s.path)
        if drop & s.columns.keys()
        else s
        for s in series
    ]


def _epoch_s(series: list[Series]) -> float:
    """Epoch of a file's clock in whole seconds; 0 if it starts near zero."""
    first_s = min((float(s.time_s[0]) for s in series), default=0.0)
    return float(np.floor(first_s)) if abs(first_s) > _EPOCH_FROM_S else 0.0


def _since(series: list[Series], epoch_s: float) -> list[Series]:
    """Subtract an epoch from times; make steps even if they are uneven by rounding only.

    A double holds a time of day to a quarter of a microsecond.
    """
    if not epoch_s:
        return series
    return [replace(s, time_s=_even(s.time_s - epoch_s)) for s in series]


def _even(time_s: Array) -> Array:
    even_s = np.linspace(time_s[0], time_s[-1], len(time_s))
    return even_s if np.max(np.abs(even_s - time_s)) < _LOST_DIGITS_S else time_s


def _first_angles(series: list[Series], dof: int) -> Array | None:
    """Joint angles in the first samples, at rest."""
    names = [f"angle_{j}_rad" for j in range(1, dof + 1)]
    for s in series:
        if all(name in s.columns for name in names):
            first = np.array([np.nanmedian(s.columns[name][:5]) for name in names])
            return first if np.isfinite(first).all() else None
    return None


def _aligned(
    series: list[Series],
    mapping: RecordingMap,
    verdict: ImportVerdict,
    rest_rad: Array | None,
    source: Source,
) -> list[Series]:
    """Align the markers to the world frame; judge the pose before and after."""
    verdict.pose = _rest_pose_of(series, mapping, rest_rad)
    if verdict.pose is not None:
        verdict.findings += judge_pose(verdict.pose, mapping, _UP.get(source.kind, "z"))
    verdict.refuse(source.file)
    series = align_markers(series, mapping, rest_rad)
    if mapping.frame.align == "base" and verdict.pose is not None:
        verdict.pose = _rest_pose_of(series, mapping, rest_rad) or verdict.pose
        verdict.findings += judge_base(verdict.pose)
        verdict.refuse(source.file)
    return series


def _rest_pose_of(
    series: list[Series], mapping: RecordingMap, rest_rad: Array | None
) -> RestPose | None:
    means: dict[str, Array] = {}
    for s in series:
        names = [n for n in mapping.layout.names if _has(s, n)]
        if not names:
            continue
        rest = rest_count(s, names)
        for name in names:
            rows = s.position_m(name)[:rest]
            seen = np.isfinite(rows).all(axis=1)
            means[name] = rows[seen].mean(axis=0) if seen.any() else np.full(3, np.nan)
    return rest_pose(means, mapping.meta(0), rest_rad)


def _clock(
    servo: list[Series],
    series: list[Series],
    source: Source,
    mapping: RecordingMap,
    verdict: ImportVerdict,
    apart_s: float = 0.0,
) -> Synchronisation:
    """Offset between clocks that were shifted to start near zero, by epochs `apart_s` apart."""
    if source.offset_s is None:
        return synchronise(servo, series, mapping.meta(0))
    given_s = source.offset_s - apart_s
    if not mapping.signals:
        found = offset_near(servo, series, mapping.meta(0), given_s)
        verdict.findings += judge_given_offset(given_s, found, apart_s)
    return Synchronisation(given_s, np.nan, by="option")
