"""Import of one recording: read, check, align, synchronise, assemble, check, write.

`import_take` is the whole way from files to a trial with its page; `Inspection` is the part without
writing. Findings are collected in an `ImportVerdict`, which refuses the import as soon as
one of them says that it cannot be right.
"""

from __future__ import annotations

import contextlib
import hashlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import open_bounded, read_toml
from firmware_py.log.recording import read_recording
from models.trials.checks.base import judge_base_offset, judge_fixed_base
from models.trials.checks.causes import ImportFinding
from models.trials.checks.markers import judge_markers, without_zeros
from models.trials.checks.payloads import judge_conditions
from models.trials.checks.pose import (
    RestPose,
    judge_base,
    judge_pose,
    judge_removed_lean,
    lean_facts,
    rest_pose,
)
from models.trials.checks.signals import judge_goal_sources, judge_shared_signals, judge_signals
from models.trials.checks.times import (
    judge_clock,
    judge_common_clock,
    judge_frame_rate,
    judge_gaps,
    judge_stated_offset,
    judge_steps,
    judge_times,
    longest_gaps,
)
from models.trials.checks.trials import judge_whole
from models.trials.checks.verdict import ImportVerdict, clock_text, write_verdict
from models.trials.clock import SYNC, Synchronisation, UnlikeMotionsError, synchronise
from models.trials.files import read_trial, write_trial
from models.trials.recordings import UP, read_series
from models.trials.recordings.assembly import assemble_trial
from models.trials.recordings.frames import align_markers, first_angles, rest_means_m, to_world
from models.trials.recordings.mapping import BASE_MARKERS, RecordingMap, Take
from models.trials.recordings.robot_log import motion_rows, with_log_conditions
from models.trials.recordings.series import Series
from models.trials.recordings.table import read_scalars
from models.trials.trial import Array, Trial


def import_take(take: Take, kind: str, name: str, directory: Path, scratch: Path) -> dict[str, Any]:
    """Import a recording of a format as the trial `name` of a directory; returns the facts of it.

    Trial and page are written to `scratch`, from where the caller moves them. The page of a refused
    import is written to the directory itself.
    """
    recording_sha256 = recording_hash(take.file)
    check_earlier_import(directory, name, recording_sha256)
    verdict = ImportVerdict(name)
    mapping, cut_off = _completed(take, kind, verdict)
    try:
        trial = Inspection(take._replace(mapping=mapping), kind, verdict).trial()
        meta = msgspec.structs.replace(trial.meta, recording_sha256=recording_sha256)
        path = write_trial(replace(trial, meta=meta), scratch)
        trial = read_trial(path, mapping.signals)  # it passes the checks of any other trial
    except InputError as error:
        if verdict.pose is None and verdict.trial is None:
            raise
        if not verdict.refused:
            verdict.findings.append(ImportFinding("refused", "refused", error.what, error.remedy))
        page = write_verdict(verdict, directory)
        where = take.file if str(scratch) in error.where else error.where
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
    facts |= verdict.as_json() | lean_facts(verdict.pose, mapping, verdict.findings)
    clock = verdict.clock
    if take.servo is not None and clock is not None:
        facts |= {"offset_s": clock.offset_s, "clock": clock_text(clock)}
        if clock.by != "option":
            facts["offset_error_s"] = clock.error_s
        if clock.by == "motion":
            facts["correlation"] = clock.correlation
    return facts


@dataclass(frozen=True)
class Inspection:
    """Import of a recording without writing; every finding is added to the verdict."""

    take: Take
    kind: str  # Format of the recording
    verdict: ImportVerdict

    def trial(self) -> Trial:
        """Trial of the recording; refused by `InputError` if a finding says that it is wrong."""
        (file, mapping, servo_file, _), verdict = self.take, self.verdict
        meta = None if mapping.signals else mapping.meta(0)  # of a trial of the link

        # Read
        series, epoch_s = _since_epoch(read_series(file, self.kind, mapping))
        servo: list[Series] = []
        servo_epoch_s = 0.0
        if servo_file:
            servo, servo_epoch_s = _since_epoch(read_series(servo_file, None, mapping.for_servo()))

        # Check each file, and align the markers to the world frame
        if meta is not None:
            zero_m = to_world(np.zeros(3), mapping.frame, "z")
            series, zeros = without_zeros(series, mapping.known_markers, zero_m)
            verdict.findings += zeros
            verdict.findings += [*judge_markers(series, mapping), *judge_goal_sources(mapping)]
            for side in filter(None, (servo, series)):
                verdict.findings += [*judge_times(side), *judge_signals(side, mapping.dof)]
            verdict.findings += judge_fixed_base(series, meta)
            series = self._aligned(series, first_angles([*servo, *series], mapping.dof))
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
        verdict.refuse(file)

        # Assemble, and check the trial
        trial = verdict.trial = assemble_trial(series, mapping, verdict.name)
        if meta is not None:
            verdict.findings += judge_conditions(trial, is_described=bool(mapping.link))
            verdict.findings += judge_whole(trial)
        verdict.refuse(file)
        return trial

    def _aligned(self, series: list[Series], rest_rad: Array | None) -> list[Series]:
        """Align the markers to the world frame; judge the pose before and after."""
        (file, mapping, *_), verdict = self.take, self.verdict

        def pose_of(series: list[Series]) -> RestPose | None:
            known: dict[str, Array] = {}
            for s in series:
                known |= rest_means_m(s, mapping.layout.names)
            return rest_pose(known, mapping.meta(0), rest_rad)

        pose = verdict.pose = pose_of(series)
        if pose is not None:
            verdict.findings += judge_pose(pose, mapping, UP.get(self.kind, "z"))
            verdict.findings += judge_removed_lean(pose, mapping)
        verdict.refuse(file)
        series = align_markers(series, mapping, rest_rad)
        if mapping.frame.align == "base" and pose is not None:
            verdict.pose = pose_of(series) or pose
            verdict.findings += judge_base(verdict.pose)
            verdict.refuse(file)
        return series

    def _on_mocap_clock(
        self, servo: list[Series], mocap: list[Series], apart_s: float
    ) -> list[Series]:
        """Servo's series on the clock of the motion capture; the files' epochs are `apart_s` apart.

        An offset that the user states is compared with what signal or motion determine.
        """
        (file, mapping, _, offset_s), verdict = self.take, self.verdict
        if offset_s is not None:
            clock = Synchronisation(offset_s - apart_s, np.nan, by="option")
            with contextlib.suppress(InputError, ValueError, IndexError):  # too little motion
                if not mapping.signals:
                    estimate = synchronise(servo, mocap, mapping.meta(0), near_s=clock.offset_s)
                    verdict.findings += judge_stated_offset(clock.offset_s, estimate, apart_s)
        else:
            try:
                clock = synchronise(servo, mocap, mapping.meta(0))
            except InputError as error:
                is_unlike = isinstance(error, UnlikeMotionsError)
                self._judge_whole_files(servo, mocap, may_be_rate=is_unlike)
                verdict.refuse(file)
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
        if may_be_rate and not self.take.mapping.signals:
            reasons = reasons or judge_frame_rate(servo, mocap, self.take.mapping.meta(0))
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


def _completed(take: Take, kind: str, verdict: ImportVerdict) -> tuple[RecordingMap, list[str]]:
    """Map with the conditions that the files hold, and the logs that were cut off."""
    mapping, cut_off = take.mapping, []
    for path in filter(None, (take.file, take.servo)):
        if path.suffix.lower() != ".mcap":
            continue
        log, end = motion_rows(read_recording(path))
        if end is not None:
            remedy = "record it again where the whole motion is needed"
            verdict.findings.append(ImportFinding("warning", "stop", end, remedy))
        mapping = with_log_conditions(mapping, log)
        cut_off += [] if log.complete else [str(path)]
    if kind == "table":
        mapping = mapping.with_scalars(read_scalars(take.file), take.file)
    return mapping, cut_off


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
