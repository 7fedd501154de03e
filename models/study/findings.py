"""Which of the paper's findings come out of these trials, in sentences with figures.

A claim holds or it does not on the data at hand; nothing is tuned towards it. `depends_on` says
what in a link, servo or laboratory brings a finding about.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import numpy as np

from models.learning.predictors import Array
from models.learning.validation import payload_key
from models.trials.deformation import deformation_index
from models.trials.trial import Trial, TrialSet

PAPER_BEST_DEGREE: Final = {1: 5, 2: 3}
NOISE_FACTOR: Final = 3.0
"""A DI loop counts as hysteresis when it is this much wider than marker noise makes it."""
MEAN_OF_ABSOLUTE: Final = 0.8
"""Mean absolute value of a normal variable, √(2/π), in standard deviations."""
ANGLE_BINS: Final = 12
MM: Final = 1e3
PERCENT: Final = 1e2


def judge_findings(
    document: Mapping[str, Any], training: TrialSet, tests: Mapping[str, TrialSet]
) -> list[dict[str, Any]]:
    """Judge the paper's findings.

    Parameters
    ----------
    document : mapping
        The study's tables so far.
    training : TrialSet
        Trial 1 of every payload.
    tests : mapping of str to TrialSet
        Held-out trials; the first one stands for the paper's trial 2.

    Returns
    -------
    list of dict
        `claim`, `holds` (true, false, or null where the trials cannot tell), `text` and
        `depends_on`.
    """
    name = next(iter(tests), None)
    listed = [_rises_with_payload(document["mean_di"])]
    if name is not None:
        table = document["mean_euclidean_distance_m"][name]["pooled"]
        listed += [
            _degree_one_is_worst(table["with_di"], name),
            _di_helps(table, name),
            _best_degree(document, table["with_di"], name),
        ]
    repeated = tests[name] if name is not None else TrialSet(())
    listed += [
        _negative_angles(training, repeated),
        _hysteresis(training),
        _more_joints_deform_more(document),
    ]
    return listed


def _finding(claim: str, holds: bool | None, text: str, depends_on: str) -> dict[str, Any]:
    verdict = {True: "Comes out", False: "Does not come out", None: "Cannot be told"}[holds]
    return {
        "claim": claim,
        "holds": holds,
        "text": f"{verdict}: {text}.",
        "depends_on": depends_on,
    }


def _percent(value: float) -> str:
    return f"{PERCENT * value:.2f} %"


def _rises_with_payload(mean_di: Mapping[str, float]) -> dict[str, Any]:
    values = list(mean_di.values())
    listed = ", ".join(f"{_percent(v)} at {k} kg" for k, v in mean_di.items())
    holds = bool(np.all(np.diff(values) > 0)) if len(values) > 1 else None
    return _finding(
        "DI rises with payload", holds, f"mean DI {listed}",
        "the bending moment at the root, so on payload, amplitude and acceleration; at small "
        "payloads marker noise alone adds about 0.07 %",
    )  # fmt: skip


def _degree_one_is_worst(by_degree: Mapping[str, float], name: str) -> dict[str, Any]:
    worst = max(by_degree, key=lambda d: by_degree[d])
    others = [v for d, v in by_degree.items() if d != "1"]
    return _finding(
        "Degree 1 is worst", worst == "1",
        f"mean Euclidean distance on {name} {MM * by_degree['1']:.1f} mm at degree 1, "
        f"{MM * min(others):.1f} to {MM * max(others):.1f} mm at the others",
        "the arc alone is curved: a linear map of the angle cannot follow it at any stiffness",
    )  # fmt: skip


def _di_helps(table: Mapping[str, Mapping[str, float]], name: str) -> dict[str, Any]:
    gains = {d: table["without_di"][d] - v for d, v in table["with_di"].items()}
    listed = ", ".join(f"{MM * g:.1f}" for g in gains.values())
    return _finding(
        "DI helps at every degree", all(g > 0 for g in gains.values()),
        f"without DI the distance on {name} is larger by {listed} mm at degrees "
        f"{', '.join(gains)}",
        "friction in the servo: without it the current would tell the load, and so the bend, by "
        "itself",
    )  # fmt: skip


def _best_degree(
    document: Mapping[str, Any], by_degree: Mapping[str, float], name: str
) -> dict[str, Any]:
    paper = PAPER_BEST_DEGREE[document["dof"]]
    best = min(by_degree, key=lambda d: by_degree[d])
    validated = document["cross_validation"]["with_di"]
    chosen = min(validated, key=lambda d: validated[d]["selection_m"])
    return _finding(
        f"{document['dof']}DOF predicts best at degree {paper}", best == str(paper),
        f"on {name} degree {best} is best with {MM * by_degree[best]:.2f} mm (degree {paper}: "
        f"{MM * by_degree[str(paper)]:.2f} mm, degree 6: {MM * by_degree['6']:.2f} mm); "
        f"cross-validation on the training trials, which never sees {name}, chooses {chosen}",
        "how much trials differ among themselves: a minimum below degree 6 needs a second trial "
        "that departs from the first by more than the higher terms gain",
    )  # fmt: skip


def _negative_angles(training: TrialSet, repeated: TrialSet) -> dict[str, Any]:
    ratios: dict[str, list[float]] = {}
    for trial in (*training, *repeated):
        di, angle_rad = deformation_index(trial), trial.angle_rad[:, 0]
        deep = 0.5 * np.abs(angle_rad).max()  # near zero the sign says nothing about the bend
        ratio = np.nanmean(di[angle_rad < -deep]) / np.nanmean(di[angle_rad > deep])
        ratios.setdefault(payload_key(trial.meta.payload_kg), []).append(float(ratio))
    every = [r for of_payload in ratios.values() for r in of_payload]
    listed = ", ".join(f"{np.mean(r):.2f} at {k} kg" for k, r in ratios.items())
    return _finding(
        "Negative angles deform more", min(every) > 1.0,
        f"DI at negative over DI at positive angles of joint 1, beyond half the amplitude: "
        f"{listed}; over single trials {min(every):.2f} to {max(every):.2f}",
        "a link that is softer or pre-bent to one side, like the paper's; a symmetric one gives 1",
    )  # fmt: skip


def _hysteresis(training: TrialSet) -> dict[str, Any]:
    loops: dict[str, HysteresisLoop] = {}
    for payload in sorted({t.meta.payload_kg for t in training}):
        of_payload = [hysteresis_loop(t) for t in training if t.meta.payload_kg == payload]
        loops[payload_key(payload)] = HysteresisLoop(*np.mean(of_payload, axis=0).tolist())
    beyond = {k: found.width > NOISE_FACTOR * found.noise for k, found in loops.items()}
    heaviest = max(loops, key=float)
    listed = ", ".join(
        f"{PERCENT * found.width:.3f} % at {k} kg ({PERCENT * found.width / found.span:.0f} % of "
        f"its range{'' if beyond[k] else ', within noise'})"
        for k, found in loops.items()
    )
    noise = max(found.noise for found in loops.values())
    return _finding(
        "DI shows hysteresis at high payload", beyond[heaviest],
        f"DI on the way up and on the way down differ on average by {listed}; marker noise alone "
        f"makes up to {PERCENT * noise:.3f} %",
        "inertia and damping as much as on hysteresis of the material: a loop at one speed does "
        "not tell them apart",
    )  # fmt: skip


class HysteresisLoop(NamedTuple):
    """DI over the angle of joint 1, up and down.

    Attributes
    ----------
    width : float
        Mean distance of the two branches, in DI.
    span : float
        Largest less smallest DI of the trial.
    noise : float
        Mean distance that the scatter of DI at rest alone would make.
    """

    width: float
    span: float
    noise: float


def hysteresis_loop(trial: Trial) -> HysteresisLoop:
    """Measure the loop that DI makes over the angle of joint 1, in bins of the angle."""
    every = deformation_index(trial)
    di, angle_rad = every[trial.moving], trial.angle_rad[trial.moving, 0]
    scatter = float(np.nanstd(every[: trial.meta.rest_samples]))
    rising = np.gradient(trial.goal_rad[trial.moving, 0]) > 0
    limit = 0.8 * np.abs(angle_rad).max()  # at the turning points both branches meet
    number = np.digitize(angle_rad, np.linspace(-limit, limit, ANGLE_BINS + 1))
    branches = []
    for k in range(1, ANGLE_BINS + 1):
        up, down = (number == k) & rising, (number == k) & ~rising
        if up.any() and down.any():
            branches.append([(angle_rad[b].mean(), np.nanmean(di[b]), b.sum()) for b in (up, down)])
    if not branches:
        return HysteresisLoop(0.0, _range(di), 0.0)
    (up_rad, up_di, up_count), (down_rad, down_di, down_count) = np.array(branches).transpose(
        1, 2, 0
    )
    # The branches' samples lie differently within a bin: compare them at the same angle.
    width = float(np.mean(np.abs(np.interp(down_rad, up_rad, up_di) - down_di)))
    noise = MEAN_OF_ABSOLUTE * scatter * float(np.mean(np.sqrt(1 / up_count + 1 / down_count)))
    return HysteresisLoop(width, _range(di), noise)


def _range(values: Array) -> float:
    return float(np.nanmax(values) - np.nanmin(values))


def _more_joints_deform_more(document: Mapping[str, Any]) -> dict[str, Any]:
    own, other = document["mean_di"], document["mean_di_other_dof"]
    one, two = (own, other) if document["dof"] == 1 else (other, own)
    shared = [k for k in own if k in other]
    if not shared:
        return _finding(
            "2DOF deforms more than 1DOF", None,
            "the directory holds trials of one kind of motion only",
            "simulate with --dof 1 2 into one directory",
        )  # fmt: skip
    ratios = {k: two[k] / one[k] for k in shared}
    listed = ", ".join(f"{v:.2f} at {k} kg" for k, v in ratios.items())
    return _finding(
        "2DOF deforms more than 1DOF", min(ratios.values()) > 1.0,
        f"mean DI of 2DOF over 1DOF: {listed}",
        "the phase of joint 2, which the paper does not give: in phase the planes add up in one "
        "direction, a quarter turn apart the link is bent all the time",
    )  # fmt: skip
