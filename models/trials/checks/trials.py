"""Trials of several directories as one set.

Checks of existing trials: each against the nominal link, and all together.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from firmware_py.errors import InputError
from firmware_py.link.link_description import STUDY_LINK
from firmware_py.link.marker_layout import MarkerLayout
from models.trials.checks.finding import ImportFinding
from models.trials.checks.goals import judge_standing_goals
from models.trials.checks.markers import (
    judge_markers,
    judge_rest,
    judge_run,
    judge_tip,
    without_zeros,
)
from models.trials.checks.motion import judge_motion, runs_against
from models.trials.checks.payloads import judge_conditions, judge_payloads, judge_undeclared
from models.trials.checks.pose import judge_pose, rest_pose
from models.trials.checks.signals import check_common_clock, judge_signals
from models.trials.checks.verdict import ImportVerdict
from models.trials.files import read_trials
from models.trials.recordings.mapping import RecordingMap
from models.trials.recordings.series import Series
from models.trials.trial import SignalRole, Trial, TrialMeta, TrialSet


def read_trial_directories(
    directories: Sequence[Path], signals: Mapping[str, SignalRole] | None = None
) -> TrialSet:
    """Read the trials of several directories.

    If two directories hold a trial of the same name, the directory's name is put in front.
    """
    if len({d.resolve() for d in directories}) < len(directories):
        raise InputError(directories[-1], "is given twice", "name each directory once")
    sets = [read_trials(d, signals and dict(signals)) for d in directories]
    refuse_unusable([t for own in sets for t in own])
    if len(sets) == 1:
        return sets[0]
    names = [t.name for own in sets for t in own]
    every = [
        replace(t, name=f"{d.name}_{t.name}") if names.count(t.name) > 1 else t
        for d, own in zip(directories, sets, strict=True) for t in own
    ]  # fmt: skip
    return TrialSet(tuple(sorted(every, key=lambda t: t.name)))


def refuse_unusable(trials: Sequence[Trial]) -> None:
    """Refuse trials whose errors would silently spoil a fit or a diagnosis."""
    known: dict[bytes, Trial] = {}
    for trial in trials:
        for j in range(1, trial.meta.dof + 1):
            goal, angle = (trial.columns.get(f"{of}_{j}_rad") for of in ("goal", "angle"))
            if goal is not None and angle is not None and runs_against(goal, angle):
                what = f"goal and angle of joint {j} run against each other"
                raise InputError(trial.path, what, f"correct the sign of angle_{j}_rad")
        for finding in (
            *judge_tip(trial), *judge_undeclared(trial), *judge_standing_goals(trial),
        ):  # fmt: skip
            if finding.level == "refused":
                raise InputError(trial.path, finding.text, finding.remedy)
        samples = hashlib.sha256()
        for name in sorted(trial.columns):
            samples.update(name.encode())
            samples.update(np.ascontiguousarray(trial.columns[name]).tobytes())
        other = known.setdefault(samples.digest(), trial)
        if other is not trial:
            raise InputError(trial.path, f"is a copy of {other.path}", "leave one of them out")


LINK_FACTS: Final = ("link_length_m", "link_width_m", "base_offset_m", "gravity", "layout")
"""Conditions that all trials of one link share."""

ONE_PRESSURE_FRACTION: Final = 0.05
"""Largest difference of pressures that count as equal: the link is 5 % stiffer [assumed]."""
COLLINEAR: Final = 0.98
"""Correlation of two angles above which their effects cannot be separated."""

CLOCK_REMEDY: Final = (
    "import the recordings again, the angles as a second file with --servo; dropstitch gap names "
    "an offset that stays (sync_offset)"
)

ZERO_REMEDY: Final = (
    "leave these cells empty, and compute the tip there from the other markers of its row"
)


def check_trial(trial: Trial) -> ImportVerdict:
    """Verdict on one trial of the link."""
    verdict = ImportVerdict(trial.name, trial=trial)
    columns = {n: v for n, v in trial.columns.items() if n != "time_s"}
    series, verdict.findings = without_zeros(
        [Series(trial.time_s, columns, trial.path)],
        trial.meta.layout.names,
        np.zeros(3),
        ZERO_REMEDY,
    )
    trial = replace(trial, columns=trial.columns | series[0].columns)
    verdict.findings += judge_signals(series, trial.meta.dof)
    markers_m = trial.markers_m
    if np.isfinite(markers_m).any():
        mapping = _map_of(trial.meta)
        verdict.findings += judge_markers(series, mapping)
        rest = markers_m[: max(trial.meta.rest_samples, 1)]
        seen = np.isfinite(rest)
        total = np.where(seen, rest, 0.0).sum(axis=0)
        means = np.where(seen.any(axis=0), total / np.maximum(seen.sum(axis=0), 1), np.nan)
        rest_rad = trial.angle_rad[: max(trial.meta.rest_samples, 1)].mean(axis=0)
        named = {name: means[k] for k, name in enumerate(trial.meta.layout.names)}
        verdict.pose = rest_pose(named, trial.meta, rest_rad)
        if verdict.pose is not None:
            verdict.findings += judge_pose(verdict.pose, mapping, "z")
        check_common_clock(series, trial.meta, verdict, CLOCK_REMEDY)
    verdict.findings += [*judge_conditions(trial), *judge_rest(trial), *judge_tip(trial)]
    verdict.findings += [*judge_motion(trial), *judge_run(trial)]
    return verdict


def check_trials(trials: TrialSet) -> list[ImportFinding]:
    """Findings on trials that are fitted together: links, pressures, payloads, held-out trials."""
    found = [*_judge_links(trials), *judge_pressures(trials)]
    found += [*judge_doubled(trials), *judge_payloads(list(trials)), *judge_not_fitted(trials)]
    _, held_out = trials.split()
    if not len(held_out):
        found.append(
            ImportFinding(
                "warning", "held out", "no trial is left to test on",
                "record a second trial of each payload before a plant or a predictor is fitted to "
                "these",
            )
        )  # fmt: skip
    two = [t for t in trials if t.meta.dof == 2]
    if two and all(_collinear(t) for t in two):
        found.append(
            ImportFinding(
                "warning", "joints", "both joints move together in every trial",
                "to train a predictor, record a trial in which one joint leads the other; identify "
                "and gap need none",
            )
        )  # fmt: skip
    return found


def refuse_mixed_links(trials: Sequence[Trial]) -> None:
    """Refuse trials of several links, as `check_trials` does, before anything is fitted."""
    for finding in _judge_links(trials)[:1]:
        first = [getattr(trials[0].meta, key) for key in LINK_FACTS]
        other = next(t for t in trials if [getattr(t.meta, key) for key in LINK_FACTS] != first)
        raise InputError(other.path, finding.text, f"correct it, or {finding.remedy}")


def judge_pressures(trials: Sequence[Trial]) -> list[ImportFinding]:
    """Finding on trials of several pressures that are used together; a pressure of 0 is unknown."""
    known = sorted({t.meta.pressure_pa for t in trials if t.meta.pressure_pa > 0})
    if not known or known[-1] <= (1 + ONE_PRESSURE_FRACTION) * known[0]:
        return []
    return [
        ImportFinding(
            "warning", "pressure",
            f"pressure_pa differs between the trials: {known[0]:g} to {known[-1]:g} Pa, and the "
            "stiffness grows with it",
            "fit a plant or a predictor to the trials of one pressure",
        )
    ]  # fmt: skip


def judge_doubled(trials: Sequence[Trial]) -> list[ImportFinding]:
    """Findings on trials of one recording, or with the same angles: a copy is no test."""
    of_angles: dict[bytes, Trial] = {}
    of_recording: dict[str, Trial] = {}
    found = []
    for trial in trials:
        what, other = "hold the same angles", of_angles.setdefault(trial.angle_rad.tobytes(), trial)
        if not trial.angle_rad.std() > 0:
            other = trial
        recording = trial.meta.recording_sha256
        if recording and of_recording.setdefault(recording, trial) is not trial:
            what, other = "are of one recording", of_recording[recording]
        if other is not trial:
            first, second = other.name, trial.name
            if first == second:
                first, second = str(other.path), str(trial.path)
            found.append(
                ImportFinding(
                    "warning", "doubled", f"{first} and {second} {what}",
                    "import each recording once; a copy is no test",
                )
            )  # fmt: skip
    return found


def judge_not_fitted(trials: TrialSet) -> list[ImportFinding]:
    """Finding on payloads of held-out trials only: nothing is fitted to them."""
    fitted, held_out = trials.split()
    known = {t.meta.payload_kg for t in fitted}
    missing = sorted({t.meta.payload_kg for t in held_out} - known)
    if not missing:
        return []
    listed = ", ".join(f"{kg:g} kg" for kg in missing)
    return [
        ImportFinding(
            "warning", "held out", f"nothing is fitted to {listed}: smaller amplitude only",
            "record these payloads with the largest amplitude too, or use them as a test",
        )
    ]  # fmt: skip


def _judge_links(trials: Sequence[Trial]) -> list[ImportFinding]:
    """Findings on trials of several links: sizes, mounting, markers."""
    found: list[ImportFinding] = []
    for key in LINK_FACTS:
        values = list(dict.fromkeys(getattr(t.meta, key) for t in trials))
        if len(values) > 1:
            listed = "; ".join(_worded(v) for v in values)
            found.append(
                ImportFinding(
                    "refused", "size", f"{key} differs between the trials: {listed}",
                    "keep the trials of each link in a directory of their own",
                )
            )  # fmt: skip
    return found


def _map_of(meta: TrialMeta) -> RecordingMap:
    """Map with the markers of a trial."""
    link = msgspec.structs.replace(
        STUDY_LINK, length_m=meta.link_length_m, width_m=meta.link_width_m, markers=meta.layout
    )
    return RecordingMap(link="of the trial", described=link)


def _worded(value: Any) -> str:
    if isinstance(value, MarkerLayout):
        return f"{value.rows} rows of {value.corners}, the first at {value.rows_m[0]:g} m"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _collinear(trial: Trial) -> bool:
    angle = trial.angle_rad
    first, second = (column - column.mean() for column in angle.T)
    size = np.linalg.norm(first) * np.linalg.norm(second)
    return bool(abs(first @ second) >= COLLINEAR * size)
