"""Findings of the paper, tested on the present trials and stated in sentences with figures.

Nothing is tuned towards a finding.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from firmware_py.core.units import FRACTION, LENGTH
from models.study.document import ByDegree, StudyDocument, StudyFinding
from models.trials.deformation import deformation_index
from models.trials.trial import Trial

PAPER_BEST_DEGREE: Final = {1: "5", 2: "3"}
"""Degree of least distance by dof, as reported in the paper."""
NOISE_FACTOR: Final = 3.0
"""Width of a DI loop, relative to the width from marker noise alone, above which it counts as
hysteresis [assumed]."""
MEAN_OF_ABSOLUTE: Final = 0.8
"""Mean absolute value of a normal variable in standard deviations: √(2/π), rounded."""
ANGLE_BINS: Final = 12  # Number of bins of the angle over a DI loop


def payload_key(payload_kg: float) -> str:
    """Key of a payload in kg in `study.json`: "0", "0.5", "1"."""
    return f"{payload_kg:g}"


def judge_findings(
    document: StudyDocument, training: Sequence[Trial], repeated: Sequence[Trial]
) -> tuple[StudyFinding, ...]:
    """Test the paper's findings; `repeated`: the first test, like the paper's trial 2, or none."""
    findings = [_rises_with_payload(document.mean_di)]
    if repeated:
        name, of_test = next(iter(document.mean_euclidean_distance_m.items()))
        with_di, without_di = of_test["pooled"]["with_di"], of_test["pooled"]["without_di"]
        findings += [
            _degree_one_is_worst(with_di, name),
            _di_helps(with_di, without_di, name),
            _best_degree(document, with_di, name),
        ]
    findings += [
        _negative_angles((*training, *repeated)),
        _hysteresis(training),
        _more_joints_deform_more(document),
    ]
    return tuple(findings)


def _finding(claim: str, holds: bool | None, text: str) -> StudyFinding:
    verdict = {True: "Reproduced", False: "Not reproduced", None: "Cannot be tested"}[holds]
    return StudyFinding(claim, holds, f"{verdict}: {text}.")


def _rises_with_payload(mean_di: Mapping[str, float]) -> StudyFinding:
    listed = ", ".join(f"{FRACTION.number(v, 2)} % at {k} kg" for k, v in mean_di.items())
    rises = bool(np.all(np.diff(list(mean_di.values())) > 0))
    holds = rises if len(mean_di) > 1 else None
    return _finding("DI rises with payload", holds, f"mean DI {listed}")


def _degree_one_is_worst(by_degree: ByDegree, name: str) -> StudyFinding:
    """The tip moves on an arc, which no linear map of the angle follows."""
    others = [v for d, v in by_degree.items() if d != "1"]
    return _finding(
        "Degree 1 is worst", by_degree["1"] > max(others),
        f"mean Euclidean distance on {name} {LENGTH.number(by_degree['1'])} mm at degree 1, "
        f"{LENGTH.number(min(others))} to {LENGTH.number(max(others))} mm at the others",
    )  # fmt: skip


def _di_helps(with_di: ByDegree, without_di: ByDegree, name: str) -> StudyFinding:
    """Without friction in the servo the current alone would determine load and deformation."""
    gains = {d: without_di[d] - v for d, v in with_di.items()}
    listed = ", ".join(f"{LENGTH.number(g)}" for g in gains.values())
    return _finding(
        "DI helps at every degree", all(g > 0 for g in gains.values()),
        f"without DI the distance on {name} is larger by {listed} mm at degrees "
        f"{', '.join(gains)}",
    )  # fmt: skip


def _best_degree(document: StudyDocument, by_degree: ByDegree, name: str) -> StudyFinding:
    """The best degree is below 6 only if the trials differ by more than higher terms gain."""
    paper = PAPER_BEST_DEGREE[document.dof]
    best = min(by_degree, key=lambda d: by_degree[d])
    validated = document.cross_validation["with_di"]
    chosen = min(validated, key=lambda d: validated[d].selection_m)
    return _finding(
        f"{document.dof}DOF predicts best at degree {paper}", best == paper,
        f"on {name} degree {best} is best with {LENGTH.number(by_degree[best], 2)} mm "
        f"(degree {paper}: {LENGTH.number(by_degree[paper], 2)} mm, degree 6: "
        f"{LENGTH.number(by_degree['6'], 2)} mm); cross-validation on the training trials, "
        f"without {name}, chooses {chosen}",
    )  # fmt: skip


def _negative_angles(trials: Sequence[Trial]) -> StudyFinding:
    """A link like the paper's is softer or bent to one side; a symmetric link has a ratio of 1."""
    ratios: dict[str, list[float]] = {}
    for trial in trials:
        di, angle_rad = deformation_index(trial), trial.angle_rad[:, 0]
        deep = 0.5 * np.abs(angle_rad).max()  # near zero the bend is small
        if angle_rad.min() < -deep and angle_rad.max() > deep:
            ratio = np.nanmean(di[angle_rad < -deep]) / np.nanmean(di[angle_rad > deep])
            ratios.setdefault(payload_key(trial.meta.payload_kg), []).append(float(ratio))
    claim = "Negative angles deform more"
    all_ratios = [ratio for by_trial in ratios.values() for ratio in by_trial]
    if not all_ratios:
        return _finding(claim, None, "no trial moves to both sides")
    listed = ", ".join(f"{np.mean(r):.2f} at {k} kg" for k, r in ratios.items())
    return _finding(
        claim, min(all_ratios) > 1.0,
        f"DI at negative over DI at positive angles of joint 1, beyond half the amplitude: "
        f"{listed}; over single trials {min(all_ratios):.2f} to {max(all_ratios):.2f}",
    )  # fmt: skip


def _hysteresis(training: Sequence[Trial]) -> StudyFinding:
    """A loop at one speed does not separate inertia and damping from hysteresis."""
    measured: dict[float, list[HysteresisLoop]] = {}
    for t in sorted(training, key=lambda t: t.meta.payload_kg):
        measured.setdefault(t.meta.payload_kg, []).append(hysteresis_loop(t))
    loops = {k: HysteresisLoop(*np.mean(v, axis=0).tolist()) for k, v in measured.items()}
    beyond = {k: loop.width > NOISE_FACTOR * loop.noise for k, loop in loops.items()}
    listed = ", ".join(
        f"{FRACTION.number(loop.width, 3)} % at {payload_key(k)} kg "
        f"({FRACTION.number(loop.width / loop.span)} % of its range"
        f"{'' if beyond[k] else ', within noise'})"
        for k, loop in loops.items()
    )
    noise = max(loop.noise for loop in loops.values())
    return _finding(
        "DI shows hysteresis at high payload", beyond[max(loops)],
        f"DI at rising and at falling angle differs on average by {listed}; marker noise alone "
        f"gives up to {FRACTION.number(noise, 3)} %",
    )  # fmt: skip


class HysteresisLoop(NamedTuple):
    """DI over the angle of joint 1, at rising and at falling angle."""

    width: float  # Mean difference of DI between the two branches
    span: float  # Largest less smallest DI of the trial
    noise: float  # Mean difference that the noise of DI at rest alone would give


def hysteresis_loop(trial: Trial) -> HysteresisLoop:
    """Measure the loop of DI over the angle of joint 1, in bins of the angle."""
    index = deformation_index(trial)
    di, angle_rad = index[trial.moving], trial.angle_rad[trial.moving, 0]
    span = float(np.nanmax(di) - np.nanmin(di))
    rising = np.gradient(trial.goal_rad[trial.moving, 0]) > 0
    limit = 0.8 * np.abs(angle_rad).max()  # the branches meet at the turning points
    number = np.digitize(angle_rad, np.linspace(-limit, limit, ANGLE_BINS + 1))
    branches = []
    for k in range(1, ANGLE_BINS + 1):
        up, down = (number == k) & rising, (number == k) & ~rising
        if up.any() and down.any():
            branches.append([(angle_rad[b].mean(), np.nanmean(di[b]), b.sum()) for b in (up, down)])
    if not branches:
        return HysteresisLoop(0.0, span, 0.0)
    (up_rad, up_di, up_count), (down_rad, down_di, down_count) = np.transpose(branches, (1, 2, 0))
    # Samples of the branches lie at other angles within a bin: compare them at the same angle.
    width = float(np.mean(np.abs(np.interp(down_rad, up_rad, up_di) - down_di)))
    scatter = float(np.nanstd(index[: trial.meta.rest_samples]))
    noise = MEAN_OF_ABSOLUTE * scatter * float(np.mean(np.sqrt(1 / up_count + 1 / down_count)))
    return HysteresisLoop(width, span, noise)


def _more_joints_deform_more(document: StudyDocument) -> StudyFinding:
    """The paper does not state the phase of joint 2, on which the ratio depends: in phase the two
    planes bend together, a quarter period apart the link is bent at all times.
    """
    claim = "2DOF deforms more than 1DOF"
    one, two = document.mean_di, document.mean_di_other_dof
    if document.dof == 2:
        one, two = two, one
    ratios = {k: two[k] / one[k] for k in document.mean_di if k in document.mean_di_other_dof}
    if not ratios:
        return _finding(claim, None, "the directory holds trials of one dof only")
    listed = ", ".join(f"{v:.2f} at {k} kg" for k, v in ratios.items())
    return _finding(claim, min(ratios.values()) > 1.0, f"mean DI of 2DOF over 1DOF: {listed}")
