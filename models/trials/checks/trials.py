"""Checks of trials that exist: each against the nominal link, and all that are fitted together."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np

from firmware_py.core.errors import InputError
from firmware_py.link.link_description import STUDY_LINK
from models.trials.checks import causes
from models.trials.checks.base import judge_root_path
from models.trials.checks.causes import ImportFinding
from models.trials.checks.markers import (
    judge_marker_run,
    judge_markers,
    judge_rest,
    without_zeros,
)
from models.trials.checks.motion import (
    judge_goals,
    judge_motion,
    judge_standing_goals,
    runs_against,
)
from models.trials.checks.payloads import judge_conditions, judge_payloads, judge_undeclared
from models.trials.checks.pose import judge_pose, rest_pose, visible_mean
from models.trials.checks.signals import judge_signals
from models.trials.checks.times import judge_common_clock
from models.trials.checks.tip import judge_tip
from models.trials.checks.verdict import ImportVerdict
from models.trials.files import PlantSignals, read_trial_directories
from models.trials.recordings.mapping import RecordingMap
from models.trials.recordings.series import Series
from models.trials.trial import Trial, TrialSet, link_differences


def check_trial(trial: Trial) -> ImportVerdict:
    """Verdict on one trial of the link."""
    verdict = ImportVerdict(trial.name, trial=trial)
    meta, rest = trial.meta, max(trial.meta.rest_samples, 1)
    columns = {n: v for n, v in trial.columns.items() if n != "time_s"}
    series, verdict.findings = without_zeros(
        [Series(trial.time_s, columns, trial.path)], meta.layout.names, np.zeros(3)
    )
    trial = replace(trial, columns=trial.columns | series[0].columns)
    verdict.findings += judge_signals(series, meta.dof)
    if np.isfinite(trial.markers_m).any():
        link = msgspec.structs.replace(
            STUDY_LINK, length_m=meta.link_length_m, width_m=meta.link_width_m, markers=meta.layout
        )
        mapping = RecordingMap(link="of the trial", described=link)
        verdict.findings += judge_markers(series, mapping)
        rest_m = dict(zip(meta.layout.names, visible_mean(trial.markers_m[:rest]), strict=True))
        verdict.pose = rest_pose(rest_m, meta, trial.angle_rad[:rest].mean(axis=0))
        if verdict.pose is not None:
            verdict.findings += judge_pose(verdict.pose, mapping, "z")
        verdict.clock, late = judge_common_clock(series, meta)
        verdict.findings += late
    verdict.findings += [*judge_conditions(trial), *judge_whole(trial)]
    return verdict


def judge_whole(trial: Trial) -> list[ImportFinding]:
    """Findings on a whole trial of the link."""
    findings = [*judge_rest(trial), *judge_tip(trial), *judge_motion(trial), *judge_goals(trial)]
    findings += judge_marker_run(trial)
    if all(f.level == "warning" for f in findings) and (path := judge_root_path(trial)):
        return [f for f in findings if f.cause != "gain"] + path  # the path explains the gain
    return findings


def read_usable_trials(
    directories: Sequence[Path], signals: PlantSignals | None = None
) -> TrialSet:
    """Trials of several directories for a fit; those that would spoil it are refused."""
    trials = read_trial_directories(directories, signals)
    refuse_unusable(trials)
    return trials


def refuse_unusable(trials: Sequence[Trial]) -> None:
    """Refuse trials whose errors would silently spoil a fit or a diagnosis."""
    known: dict[bytes, Trial] = {}
    for trial in trials:
        findings: list[ImportFinding] = []
        for j in range(1, trial.meta.dof + 1):
            goal, angle = (trial.columns.get(f"{of}_{j}_rad") for of in ("goal", "angle"))
            if goal is not None and angle is not None and runs_against(goal, angle):
                findings += causes.GOAL_AGAINST.raised(joint=j)
        findings += [*judge_tip(trial), *judge_undeclared(trial), *judge_standing_goals(trial)]
        for finding in findings:
            if finding.level == "refused":
                raise InputError(trial.path, finding.text, finding.remedy)
        samples = hashlib.sha256()
        for name in sorted(trial.columns):
            samples.update(name.encode())
            samples.update(np.ascontiguousarray(trial.columns[name]).tobytes())
        other = known.setdefault(samples.digest(), trial)
        if other is not trial:
            raise InputError(trial.path, f"is a copy of {other.path}", "leave one of them out")


# --- trials that are fitted together -------------------------------------------------------------


def check_trials(trials: TrialSet) -> list[ImportFinding]:
    """Findings on trials that are fitted together: links, pressures, payloads, held-out trials."""
    findings = [*_judge_links(trials), *judge_pressures(trials), *judge_doubled(trials)]
    findings += [*judge_payloads(list(trials)), *judge_not_fitted(trials)]
    if not len(trials.split()[1]):
        findings += causes.NO_TEST.raised()
    two = [t for t in trials if t.meta.dof == 2 and np.ptp(t.angle_rad, axis=0).all()]
    if two and all(abs(float(np.corrcoef(*t.angle_rad.T)[0, 1])) >= 0.98 for t in two):
        findings += causes.TOGETHER.raised()
    return findings


def _judge_links(trials: Sequence[Trial]) -> list[ImportFinding]:
    """Findings on trials of other links than the first one's: sizes, mounting, markers."""
    values: dict[str, list[str]] = {}
    for trial in trials[1:]:
        for key, first, other in link_differences(trials[0].meta, trial.meta):
            values.setdefault(key, [first]).append(other)
    findings: list[ImportFinding] = []
    for key, listed in values.items():
        findings += causes.LINK_SIZE.raised(key=key, listed="; ".join(dict.fromkeys(listed)))
    return findings


def judge_pressures(trials: Sequence[Trial]) -> list[ImportFinding]:
    """Finding on trials of several pressures that are used together; a pressure of 0 is unknown.

    Pressures within 5 %, of as much in the limit moment, count as equal [assumed].
    """
    known = sorted({t.meta.pressure_pa for t in trials if t.meta.pressure_pa > 0})
    if not known or known[-1] <= 1.05 * known[0]:
        return []
    return causes.PRESSURES.raised(low=known[0], high=known[-1])


def judge_doubled(trials: Sequence[Trial]) -> list[ImportFinding]:
    """Findings on trials of one recording, or with the same angles: a copy is no test."""
    known: dict[bytes | str, Trial] = {}
    findings: list[ImportFinding] = []
    for trial in trials:
        keys: list[bytes | str] = [trial.meta.recording_sha256] * bool(trial.meta.recording_sha256)
        if trial.angle_rad.std() > 0:
            keys.append(trial.angle_rad.tobytes())
        other = next((known[key] for key in keys if key in known), None)
        known |= {key: trial for key in keys if key not in known}
        if other is None:
            continue
        first, second = other.name, trial.name
        if first == second:
            first, second = str(other.path), str(trial.path)
        findings += causes.COPY.raised(first=first, second=second)
    return findings


def judge_not_fitted(trials: TrialSet) -> list[ImportFinding]:
    """Finding on payloads of held-out trials only: nothing is fitted to them."""
    fitted, held_out = ({t.meta.payload_kg for t in part} for part in trials.split())
    payloads = [f"{kg:g} kg" for kg in sorted(held_out - fitted)]
    return causes.NOT_FITTED.raised(payloads=payloads) if payloads else []
