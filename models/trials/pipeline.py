"""Import of one recording: read, check, align, synchronise, assemble, check, write.

`import_take` is the whole way from files to a trial with its page; `Inspection` is the part without
writing. Findings are collected in an `ImportVerdict`, which refuses the import as soon as
one of them says that it cannot be right.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import open_bounded, read_toml
from firmware_py.core.units import ANGLE, LENGTH
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
    judge_stated_offset,
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
    SYNC,
    Synchronisation,
    UnlikeMotionsError,
    synchronise,
)
from models.trials.files import read_trial, write_trial
from models.trials.recordings import UP, read_series
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
        trial = Inspection(source, mapping, verdict).trial()
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
    facts |= verdict.as_json() | _lean_facts(verdict, mapping)
    clock = verdict.clock
    if source.servo is not None and clock is not None:
        facts |= {"offset_s": clock.offset_s, "clock": clock_text(clock)}
        if clock.by != "option":
            facts["offset_error_s"] = clock.error_s
        if clock.by == "motion":
            facts["correlation"] = clock.correlation
    return facts


@dataclass(frozen=True)
class Inspection:
    """Import of a recording without writing; every finding is added to the verdict."""

    source: Source
    mapping: RecordingMap
    verdict: ImportVerdict

    def trial(self) -> Trial:
        """Trial of the recording; refused by `InputError` if a finding says that it is wrong."""
        mapping, verdict = self.mapping, self.verdict
        meta = None if mapping.signals else mapping.meta(0)  # of a trial of the link

        # Read
        series, epoch_s = _since_epoch(read_series(self.source.file, self.source.kind, mapping))
        servo: list[Series] = []
        servo_epoch_s = 0.0
        if self.source.servo:
            servo = read_series(self.source.servo, None, mapping.for_servo())
            servo, servo_epoch_s = _since_epoch(servo)

        # Check each file, and align the markers to the world frame
        if meta is not None:
            zero_m = to_world(np.zeros(3), mapping.frame, "z")
            series, zeros = without_zeros(series, mapping.known_markers, zero_m)
            verdict.findings += zeros
            verdict.findings += [*judge_markers(series, mapping), *judge_goal_sources(mapping)]
            for side in filter(None, (servo, series)):
                verdict.findings += [*judge_times(side), *judge_signals(side, mapping.dof)]
            verdict.findings += judge_fixed_base(series, meta)
            series = self._aligned(series, _first_angles([*servo, *series], mapping.dof))
        for side in (servo, series):
            verdict.findings += judge_steps(side, mapping)

        # Synchronise
        if servo:
            servo = self._on_mocap_clock(servo, series, epoch_s - servo_epoch_s)
        elif meta is not None:
            verdict.clock, late = judge_common_clock(series, meta)
            verdict.findings += late
        series = [*series, *servo]
        if meta is not None:
            verdict.findings += judge_base_offset(series, meta)
        base = [f"{name}_{axis}_m" for name in BASE_MARKERS for axis in "xyz"]
        series = _without(series, SYNC, *base)
        verdict.steps_s = {s.path.name: float(np.median(np.diff(s.time_s))) for s in series}
        start_s = max(s.time_s[0] for s in series)
        verdict.gaps = longest_gaps(series, start_s, min(s.time_s[-1] for s in series))
        verdict.findings += judge_gaps(verdict.gaps)
        if servo and verdict.clock and not verdict.refused:
            verdict.findings += judge_clock(verdict.clock)
            if verdict.refused:
                drifts = bool(verdict.clock.drifts)
                self._judge_whole_files(servo, series[: -len(servo)], may_be_rate=drifts)
        verdict.refuse(self.source.file)

        # Assemble, and check the trial
        trial = verdict.trial = assemble_trial(series, mapping, verdict.name)
        if meta is not None:
            verdict.findings += judge_conditions(trial, is_described=bool(mapping.link))
            verdict.findings += judge_whole(trial)
        verdict.refuse(self.source.file)
        return trial

    def _aligned(self, series: list[Series], rest_rad: Array | None) -> list[Series]:
        """Align the markers to the world frame; judge the pose before and after."""
        verdict, by_base = self.verdict, self.mapping.frame.align == "base"
        pose = verdict.pose = self._rest_pose(series, rest_rad)
        if pose is not None:
            verdict.findings += judge_pose(pose, self.mapping, UP.get(self.source.kind, "z"))
            if lean := _removed_lean(pose, self.mapping):
                verdict.findings += causes.REMOVED_LEAN.beyond(lean[1], lean=_lean_words(*lean))
        verdict.refuse(self.source.file)
        series = align_markers(series, self.mapping, rest_rad)
        if by_base and pose is not None:
            verdict.pose = self._rest_pose(series, rest_rad) or pose
            verdict.findings += judge_base(verdict.pose)
            verdict.refuse(self.source.file)
        return series

    def _rest_pose(self, series: list[Series], rest_rad: Array | None) -> RestPose | None:
        known: dict[str, Array] = {}
        for s in series:
            known |= _rest_means_m(s, self.mapping.layout.names)
        return rest_pose(known, self.mapping.meta(0), rest_rad)

    def _on_mocap_clock(
        self, servo: list[Series], mocap: list[Series], apart_s: float
    ) -> list[Series]:
        """Servo's series on the clock of the motion capture; the files' epochs are `apart_s` apart.

        An offset that the user states is compared with what signal or motion determine.
        """
        verdict, link = self.verdict, not self.mapping.signals
        if self.source.offset_s is not None:
            clock = Synchronisation(self.source.offset_s - apart_s, np.nan, by="option")
            with contextlib.suppress(InputError, ValueError, IndexError):  # too little motion
                if link:
                    meta = self.mapping.meta(0)
                    estimate = synchronise(servo, mocap, meta, near_s=clock.offset_s)
                    verdict.findings += judge_stated_offset(clock.offset_s, estimate, apart_s)
        else:
            try:
                clock = synchronise(servo, mocap, self.mapping.meta(0))
            except InputError as error:
                is_unlike = isinstance(error, UnlikeMotionsError)
                self._judge_whole_files(servo, mocap, may_be_rate=is_unlike)
                verdict.refuse(self.source.file)
                raise
        servo = [replace(s, time_s=s.time_s + clock.offset_s) for s in servo]
        verdict.findings += judge_shared_signals(_without(servo, SYNC), _without(mocap, SYNC))
        second_s = clock.second_offset_s + apart_s
        verdict.clock = replace(clock, offset_s=clock.offset_s + apart_s, second_offset_s=second_s)
        return servo

    def _judge_whole_files(
        self, servo: list[Series], mocap: list[Series], may_be_rate: bool
    ) -> None:
        """Put in front why the clocks of two files may not fit: a gap in one of them, or a rate."""
        self.verdict.gaps = [
            gap for side in (servo, mocap)
            for gap in longest_gaps(side, side[0].time_s[0], side[0].time_s[-1])
        ]  # fmt: skip
        reasons = judge_gaps(self.verdict.gaps)
        if may_be_rate and not self.mapping.signals:
            reasons = reasons or judge_frame_rate(servo, mocap, self.mapping.meta(0))
        self.verdict.findings[:0] = reasons


def _without(series: list[Series], *names: str) -> list[Series]:
    """Series without channels that serve the import and are no signals of a trial."""
    return [
        replace(s, columns={n: v for n, v in s.columns.items() if n not in names}) for s in series
    ]


# --- before reading: the recording itself, and conditions that it holds --------------------------


def recording_hash(path: Path) -> str:
    """SHA-256 of a recording; for a folder (a ROS 2 bag), over its files in order of name."""
    is_bag = path.is_dir()
    digest = hashlib.sha256()
    for file in sorted(path.iterdir()) if is_bag else [path]:
        if is_bag:
            digest.update(b"\0" + file.name.encode("utf-8", "surrogateescape") + b"\0")
        with open_bounded(file, "name an existing file") as stream:
            while part := stream.read(1 << 20):
                digest.update(part)
    return digest.hexdigest()


def check_earlier_import(directory: Path, name: str, recording_sha256: str) -> None:
    """Refuse to replace a trial of another recording, or files that are no trial.

    An imported trial stores the hash of its recording, so the same recording may be imported again,
    for example with another map. Suffixes may be in capitals.
    """
    files = (f"{name}.csv".casefold(), f"{name}.toml".casefold())
    inside = directory.iterdir() if directory.is_dir() else ()
    there = {p.name.casefold(): p for p in inside if p.name.casefold() in files}
    if not there:
        return
    first, last = there[min(there)], there[max(there)]  # The TOML file if there is one
    try:
        document = read_toml(last)
    except InputError:
        document = {}
    remedy = "give another --out, or move it away"
    if "recording_sha256" not in document:
        raise InputError(first, "would be replaced, and is no imported trial", remedy)
    if document["recording_sha256"] != recording_sha256:
        raise InputError(first, "is a trial of another recording", remedy)


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

_LYING_RAD: Final = np.radians(30.0)
"""Tilt above which the file's upward axis is another, and a lean of the link is not known."""
_REST_RANGE_M: Final = 3e-3
"""Largest displacement of a marker at rest."""


def _first_angles(series: list[Series], dof: int) -> Array | None:
    """Joint angles in the first samples, at rest."""
    names = [f"angle_{j}_rad" for j in range(1, dof + 1)]
    for s in series:
        if all(name in s.columns for name in names):
            first = np.array([np.nanmedian(s.columns[name][:5]) for name in names])
            return first if np.isfinite(first).all() else None
    return None


def _rest_means_m(series: Series, markers: Sequence[str]) -> dict[str, Array]:
    """Mean place (3,) of each marker in the leading samples in which none has moved.

    It is NaN for a marker that was occluded in all of them.
    """
    names = [name for name in markers if series.has(name)]
    if not names:
        return {}
    places_m = np.stack([series.position_m(name) for name in names], axis=1)  # (n, markers, 3)
    first = np.argmax(np.isfinite(places_m), axis=0)
    first_m = np.take_along_axis(places_m, first[None], axis=0)
    moved = (np.abs(places_m - first_m) > _REST_RANGE_M).any(axis=(1, 2))  # NaN does not count
    rest_m = places_m[: max(int(np.argmax(moved)), 1)] if moved.any() else places_m
    known = np.asarray(np.isfinite(rest_m).all(axis=2))
    return {
        name: rest_m[known[:, k], k].mean(axis=0) if known[:, k].any() else np.full(3, np.nan)
        for k, name in enumerate(names)
    }


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
    means_m = _rest_means_m(series, mapping.known_markers)
    visible = [n for n in nominal if n in means_m and np.isfinite(means_m[n]).all()]
    least = 3 if by_base else 4
    if len(visible) < least:
        raise InputError(
            series.path,
            f"shows {len(visible)} markers {'of the base ' if by_base else ''}at rest",
            f"align needs at least {least}" + (": map b01 … b04" if by_base else ""),
        )
    rotation, shift_m = fit_rigid_motion(
        np.array([means_m[n] for n in visible]), np.array([nominal[n] for n in visible])
    )
    moved = {n: series.position_m(n) @ rotation.T + shift_m for n in means_m}
    return replace(series, columns=series.columns | marker_columns(moved))


def _removed_lean(pose: RestPose, mapping: RecordingMap) -> tuple[float, float] | None:
    """Lean in rad, and in m at the tip, that an alignment by the link itself takes away."""
    if mapping.frame.align != "rest" or pose.tilt_rad > _LYING_RAD:
        return None
    meta = mapping.meta(0)
    reach_m = meta.base_offset_m + meta.link_length_m
    return pose.tilt_rad, float(reach_m * np.sin(pose.tilt_rad))


def _lean_facts(verdict: ImportVerdict, mapping: RecordingMap) -> dict[str, Any]:
    """Lean of the link at rest, if it was removed, or if it is large and no finding names it."""
    pose = verdict.pose
    if pose is None:
        return {}
    if lean := _removed_lean(pose, mapping):
        text = f'align = "rest" took away a lean of {_lean_words(*lean)}'
        return {"removed_lean_rad": lean[0], "removed_lean_tip_m": lean[1], "lean": text}
    is_named = any(finding.cause == "tilt" for finding in verdict.findings)
    is_large = pose.tip_aside_m > causes.ORIGIN.limits[0]
    if mapping.frame.align != "none" or is_named or not is_large:
        return {}
    words = _lean_words(pose.tilt_rad, pose.tip_aside_m)
    return {"lean": f"at rest the link leans by {words} (a prebend, or a tilted frame)"}


def _lean_words(angle_rad: float, tip_m: float) -> str:
    return f"{ANGLE.text(angle_rad)}, {LENGTH.text(tip_m, 0)} at the tip"


# --- clocks --------------------------------------------------------------------------------------

_LOST_DIGITS_S: Final = 2e-6
"""Rounding error of a time since 1970 as a double, including a conversion of its unit."""


def _since_epoch(series: list[Series]) -> tuple[list[Series], float]:
    """Series of one file on a clock near zero, and the epoch in whole seconds that was subtracted.

    A double holds a time of day to a quarter of a microsecond: steps that are uneven by rounding
    only are made even.
    """
    epoch_s = float(np.floor(min(s.time_s[0] for s in series)))
    if abs(epoch_s) < 1e6:  # twelve days
        return series, 0.0
    times_s = [s.time_s - epoch_s for s in series]
    evens_s = [np.linspace(time_s[0], time_s[-1], len(time_s)) for time_s in times_s]
    return [
        replace(s, time_s=even_s if np.abs(even_s - time_s).max() < _LOST_DIGITS_S else time_s)
        for s, time_s, even_s in zip(series, times_s, evens_s, strict=True)
    ], epoch_s
