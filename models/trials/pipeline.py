"""Import of one recording: read, check, align, synchronise, assemble, check, write.

`import_take` is the whole way from files to a trial with its page; `inspect_import` is the part
without writing. Findings are collected in an `ImportVerdict`, which refuses the import as soon as
one of them says that it cannot be right.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np

from firmware_py.display_units import ANGLE, LENGTH
from firmware_py.errors import InputError
from firmware_py.files.input_files import open_bounded, read_toml
from firmware_py.link.marker_layout import square_corners_m
from firmware_py.log.recording import read_recording
from models.shared.kinematics import base_rotation
from models.trials.checks import causes
from models.trials.checks.base import judge_base_offset, judge_fixed_base
from models.trials.checks.causes import ImportFinding
from models.trials.checks.clocks import (
    judge_clock,
    judge_common_clock,
    judge_frame_rate,
    judge_given_offset,
)
from models.trials.checks.markers import judge_markers, without_zeros
from models.trials.checks.page import clock_text, write_verdict
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
from models.trials.files import read_trial, write_trial
from models.trials.recordings import read_series
from models.trials.recordings.assembly import assemble_trial
from models.trials.recordings.mapping import BASE_MARKERS, RecordingMap
from models.trials.recordings.robot_log import motion_rows, with_log_conditions
from models.trials.recordings.series import (
    Series,
    fit_rigid_motion,
    marker_columns,
    nominal_markers_m,
    to_world,
)
from models.trials.recordings.table import read_scalars
from models.trials.trial import Array, Trial


class Source(NamedTuple):
    """Files and options of one import."""

    file: Path  # Recording
    kind: str  # Format of the recording
    servo: Path | None = None  # Second file with the servo's signals
    offset_s: float | None = None  # Offset of the servo's clock; None to estimate it


def import_take(
    source: Source, mapping: RecordingMap, name: str, directory: Path, scratch: Path
) -> dict[str, Any]:
    """Import a recording as the trial `name` of a directory; returns the facts about it.

    Trial and page are written to `scratch`, from where the caller moves them. The page of a refused
    import is written to the directory itself.
    """
    recording_sha256 = recording_hash(source.file)
    check_earlier_import(directory, name, recording_sha256)
    verdict = ImportVerdict(name)
    mapping, cut_off = _completed(mapping, source, verdict)
    try:
        trial = inspect_import(source, mapping, verdict)
        meta = msgspec.structs.replace(trial.meta, recording_sha256=recording_sha256)
        path = write_trial(replace(trial, meta=meta), scratch)
        trial = read_trial(path, mapping.signals)  # it passes the checks of any other trial
    except InputError as error:
        if verdict.pose is None and verdict.trial is None:
            raise
        if not verdict.refused:
            verdict.findings.append(ImportFinding("refused", "refused", error.what, error.remedy))
        page = write_verdict(verdict, directory)
        where = source.file if str(scratch) in error.where else error.where
        raise InputError(where, error.what, f"{error.remedy} (see {page})") from None
    write_verdict(verdict, scratch)
    facts = {
        "trial": str(directory / path.name),
        "page": str(directory / f"{name}.html"),
        "rows": len(trial),
        "step_s": trial.step_s,
        "rest_samples": trial.meta.rest_samples,
        "occluded_share": None if mapping.signals else float(np.mean(np.isnan(trial.markers_m))),
        "cut_off": cut_off,
    }
    facts |= verdict.as_json() | _lean(verdict, mapping)
    clock = verdict.clock
    if source.servo is not None and clock is not None:
        facts |= {"offset_s": clock.offset_s, "clock": clock_text(clock)}
        if clock.by != "option":
            facts["offset_error_s"] = clock.error_s
        if clock.by == "motion":
            facts["correlation"] = clock.correlation
    return facts


def inspect_import(source: Source, mapping: RecordingMap, verdict: ImportVerdict) -> Trial:
    """Trial of a recording, with every finding in the verdict; refused by `InputError`."""
    link = not mapping.signals

    # Read
    series = read_series(source.file, source.kind, mapping)
    if source.kind == "table":
        series = [_table_to_world(s, mapping) for s in series]
    servo = read_series(source.servo, None, mapping.for_servo()) if source.servo else []
    epoch_s, servo_epoch_s = _epoch_s(series), _epoch_s(servo)
    series, servo = _since(series, epoch_s), _since(servo, servo_epoch_s)

    # Check each file, and align the markers to the world frame
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

    # Synchronise
    if servo:
        servo = _on_mocap_clock(servo, series, source, mapping, verdict, epoch_s - servo_epoch_s)
        series = [*series, *servo]
    elif link:
        verdict.clock, late = judge_common_clock(series, mapping.meta(0))
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

    # Assemble, and check the trial
    trial = verdict.trial = assemble_trial(series, mapping, verdict.name)
    if link:
        verdict.findings += judge_conditions(trial, is_described=bool(mapping.link))
        verdict.findings += judge_whole(trial)
    verdict.refuse(source.file)
    return trial


# --- before reading: the recording itself, and conditions that it holds --------------------------

_MOST_FILES: Final = 1000
"""Most files of a folder that are hashed; the reader of bags accepts fewer."""
_PART_BYTES: Final = 1 << 20


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
    """Refuse to replace a trial of another recording, or files that are no trial.

    An imported trial stores the hash of its recording, so the same recording may be imported again,
    for example with another map. Suffixes may be in capitals.
    """
    files = {f"{name}.csv".casefold(), f"{name}.toml".casefold()}
    inside = directory.iterdir() if directory.is_dir() else ()
    there = sorted(
        (p for p in inside if p.name.casefold() in files), key=lambda p: p.suffix.lower()
    )
    if not there:
        return
    try:
        document = read_toml(there[-1])
    except InputError:
        document = {}
    known = document.get("recording_sha256")
    remedy = "give another --out, or move it away"
    if known is None:
        raise InputError(there[0], "would be replaced, and is no imported trial", remedy)
    if known != recording_sha256:
        raise InputError(there[0], "is a trial of another recording", remedy)


def _completed(
    mapping: RecordingMap, source: Source, verdict: ImportVerdict
) -> tuple[RecordingMap, list[str]]:
    """Map with the conditions that the files hold, and the logs that were cut off."""
    cut_off = []
    for path in filter(None, (source.file, source.servo)):
        if path.suffix.lower() != ".mcap":
            continue
        log, end = motion_rows(read_recording(path))
        if end is not None:
            remedy = "record it again where the whole motion is needed"
            verdict.findings.append(ImportFinding("warning", "stop", end, remedy))
        mapping = with_log_conditions(mapping, log)
        cut_off += [] if log.complete else [str(path)]
    if source.kind == "table":
        mapping = mapping.with_scalars(read_scalars(source.file), source.file)
    return mapping, cut_off


# --- frames --------------------------------------------------------------------------------------

_UP: Final = {"motive": "y"}
"""Upward axis by format; z in all other formats."""
_LYING_RAD: Final = np.radians(30.0)
"""Tilt above which the file's upward axis is another, and a lean of the link is not known."""
_REST_RANGE_M: Final = 3e-3
"""Largest displacement of a marker at rest."""


def _table_to_world(series: Series, mapping: RecordingMap) -> Series:
    """Turn the markers of a table into the world frame; other readers do it themselves."""
    names = [n for n in mapping.known_markers if series.has(n)]
    frame = mapping.frame
    moved = frame.up not in (None, "z") or frame.yaw_deg or any(frame.origin_m) or frame.mirror
    if not names or not moved:
        return series
    world_m = to_world({n: series.position_m(n) for n in names}, frame, "z")
    return replace(series, columns=series.columns | marker_columns(world_m))


def _without_zeros(
    series: list[Series], mapping: RecordingMap, verdict: ImportVerdict
) -> list[Series]:
    """Remove samples of markers at the file's zero from series in the world frame."""
    zero_m = to_world({"zero": np.zeros((1, 3))}, mapping.frame, "z")["zero"][0]
    series, found = without_zeros(series, mapping.known_markers, zero_m)
    verdict.findings += found
    return series


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
        verdict.findings += _judge_removed_lean(verdict.pose, mapping)
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
    means_m = [_rest_means_m(s, mapping.layout.names) for s in series]
    known = {name: mean_m for means in means_m for name, mean_m in means.items()}
    return rest_pose(known, mapping.meta(0), rest_rad)


def _rest_means_m(series: Series, markers: Sequence[str]) -> dict[str, Array]:
    """Mean place (3,) of each marker in the leading samples in which none has moved.

    It is NaN for a marker that was occluded in all of them.
    """
    places_m = {name: series.position_m(name) for name in markers if series.has(name)}
    rest = len(series.time_s)
    for column in (column[:rest] for place_m in places_m.values() for column in place_m.T):
        first_m = column[int(np.argmax(np.isfinite(column)))]
        moved = np.flatnonzero(np.abs(column - first_m) > _REST_RANGE_M)  # NaN does not count
        rest = min(rest, int(moved[0])) if len(moved) else rest
    means_m = {}
    for name, place_m in places_m.items():
        rows = place_m[: max(rest, 1)]
        seen = np.isfinite(rows).all(axis=1)
        means_m[name] = rows[seen].mean(axis=0) if seen.any() else np.full(3, np.nan)
    return means_m


def align_markers(
    series: list[Series], mapping: RecordingMap, rest_rad: Array | None = None
) -> list[Series]:
    """Move the markers onto the nominal robot, by rest pose or base as the map says.

    `rest_rad` (dof,) are the joint angles at rest.
    """
    if mapping.frame.align == "none":
        return series
    meta, by_base = mapping.meta(0), mapping.frame.align == "base"
    plate_m = [(x, y, meta.base_offset_m) for x, y in square_corners_m(meta.link_width_m)]
    places_m = np.array(plate_m) if by_base else nominal_markers_m(meta)
    turn = np.eye(3) if rest_rad is None else base_rotation(np.atleast_2d(rest_rad))[0]
    wanted = BASE_MARKERS if by_base else meta.layout.names
    nominal = dict(zip(wanted, places_m @ turn.T, strict=True))
    return [_moved_onto(s, nominal, mapping) if s.has("m01") else s for s in series]


def _moved_onto(series: Series, nominal: dict[str, Array], mapping: RecordingMap) -> Series:
    """Series whose markers at rest are moved onto nominal places by the best rigid motion.

    A link with a prebend looks like a tilted frame, so aligning by the link itself is an option.
    """
    by_base = mapping.frame.align == "base"
    markers_m = {n: series.position_m(n) for n in mapping.known_markers if series.has(n)}
    means_m = _rest_means_m(series, mapping.known_markers)
    seen = [n for n in nominal if n in means_m and np.isfinite(means_m[n]).all()]
    least = 3 if by_base else 4
    if len(seen) < least:
        raise InputError(
            series.path,
            f"shows {len(seen)} markers {'of the base ' if by_base else ''}at rest",
            f"align needs at least {least}" + (": map b01 … b04" if by_base else ""),
        )
    rotation, shift_m = fit_rigid_motion(
        np.array([means_m[n] for n in seen]), np.array([nominal[n] for n in seen])
    )
    moved = {n: position @ rotation.T + shift_m for n, position in markers_m.items()}
    return replace(series, columns=series.columns | marker_columns(moved))


def _removed_lean(pose: RestPose | None, mapping: RecordingMap) -> tuple[float, float] | None:
    """Lean in rad, and in m at the tip, that an alignment by the link itself takes away."""
    if pose is None or mapping.frame.align != "rest" or pose.tilt_rad > _LYING_RAD:
        return None
    meta = mapping.meta(0)
    reach_m = meta.base_offset_m + meta.link_length_m
    return pose.tilt_rad, float(reach_m * np.sin(pose.tilt_rad))


def _judge_removed_lean(pose: RestPose, mapping: RecordingMap) -> list[ImportFinding]:
    removed = _removed_lean(pose, mapping)
    if removed is None:
        return []
    return causes.REMOVED_LEAN.beyond(removed[1], lean=_lean_words(*removed))


def _lean(verdict: ImportVerdict, mapping: RecordingMap) -> dict[str, Any]:
    """Facts on the lean of the link at rest: removed, or left in without a finding that says so."""
    pose = verdict.pose
    if (removed := _removed_lean(pose, mapping)) is not None:
        lean = f'align = "rest" took away a lean of {_lean_words(*removed)}'
        return {"removed_lean_rad": removed[0], "removed_lean_tip_m": removed[1], "lean": lean}
    is_told = any(finding.cause == "tilt" for finding in verdict.findings)
    if (
        pose is None
        or mapping.frame.align != "none"
        or is_told
        or pose.tip_aside_m <= causes.ORIGIN.limits[0]
    ):
        return {}
    words = _lean_words(pose.tilt_rad, pose.tip_aside_m)
    return {"lean": f"at rest the link leans by {words} (a prebend, or a tilted frame)"}


def _lean_words(angle_rad: float, tip_m: float) -> str:
    return f"{ANGLE.text(angle_rad)}, {LENGTH.text(tip_m, 0)} at the tip"


def _without_base(series: list[Series]) -> list[Series]:
    """Remove the base's markers, which are not signals of a trial."""
    drop = {f"{name}_{axis}_m" for name in BASE_MARKERS for axis in "xyz"}
    return [
        replace(s, columns={n: v for n, v in s.columns.items() if n not in drop}) for s in series
    ]


# --- clocks --------------------------------------------------------------------------------------

_EPOCH_FROM_S: Final = 1e6
"""First time of a clock above which it counts from an epoch: twelve days."""
_LOST_DIGITS_S: Final = 2e-6
"""Rounding error of a time since 1970 as a double, including a conversion of its unit."""


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


def _on_mocap_clock(
    servo: list[Series],
    mocap: list[Series],
    source: Source,
    mapping: RecordingMap,
    verdict: ImportVerdict,
    apart_s: float,
) -> list[Series]:
    """Servo's series on the clock of the motion capture; the files' epochs are `apart_s` apart."""
    try:
        if source.offset_s is None:
            clock = synchronise(servo, mocap, mapping.meta(0))
        else:
            clock = Synchronisation(source.offset_s - apart_s, np.nan, by="option")
            if not mapping.signals:
                found = offset_near(servo, mocap, mapping.meta(0), clock.offset_s)
                verdict.findings += judge_given_offset(clock.offset_s, found, apart_s)
    except InputError as error:
        unlike = isinstance(error, UnlikeMotionsError)
        _judge_whole_files(servo, mocap, mapping, verdict, unlike)
        verdict.refuse(source.file)
        raise
    servo = shift_clock(servo, clock.offset_s)
    verdict.findings += judge_shared_signals(without_sync(servo), without_sync(mocap))
    second_s = clock.second_offset_s + apart_s
    verdict.clock = replace(clock, offset_s=clock.offset_s + apart_s, second_offset_s=second_s)
    return servo


def _judge_whole_files(
    servo: list[Series],
    mocap: list[Series],
    mapping: RecordingMap,
    verdict: ImportVerdict,
    may_be_rate: bool,
) -> None:
    """Put in front why the clocks of two files may not fit: a gap in one of them, or its rate."""
    verdict.gaps = [
        gap for side in (servo, mocap)
        for gap in longest_gaps(side, side[0].time_s[0], side[0].time_s[-1])
    ]  # fmt: skip
    found = judge_gaps(verdict.gaps)
    if may_be_rate and not mapping.signals:
        found = found or judge_frame_rate(servo, mocap, mapping.meta(0))
    verdict.findings[:0] = found
