"""Checks of existing trials: each against the nominal link, and all together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import msgspec
import numpy as np

from firmware_py.errors import InputError
from firmware_py.link.link_description import STUDY_LINK
from firmware_py.link.marker_layout import MarkerLayout
from models.trials.importers.mapping import RecordingMap
from models.trials.importers.series import Series
from models.trials.trial import Trial, TrialMeta, TrialSet
from models.trials.verdict.completeness import judge_markers, judge_rest
from models.trials.verdict.finding import ImportFinding
from models.trials.verdict.import_verdict import ImportVerdict
from models.trials.verdict.load_findings import judge_payloads
from models.trials.verdict.motion_findings import judge_motion
from models.trials.verdict.pose_findings import judge_pose
from models.trials.verdict.rest_pose import rest_pose
from models.trials.verdict.signal_findings import check_common_clock, judge_signals
from models.trials.verdict.whole_run.condition_findings import judge_conditions
from models.trials.verdict.whole_run.run_findings import judge_run
from models.trials.verdict.whole_run.tip_findings import judge_tip
from models.trials.verdict.whole_run.zero_markers import without_zeros

__all__ = [
    "check_trial", "check_trials", "judge_doubled", "judge_not_fitted", "judge_pressures",
    "refuse_mixed_links",
]  # fmt: skip

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
