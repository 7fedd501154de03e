"""Next experiment: the fixed motions, ranked by how well they separate a diagnosis's hypotheses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
import tomli_w

from firmware_py.config import UNWATCHED_RATE_RAD_S
from firmware_py.core.errors import InputError
from firmware_py.core.motion import KINDS, Motion, MotionDocument
from firmware_py.core.output_files import write_whole
from firmware_py.core.signals import PERIOD_S
from firmware_py.core.units import ANGLE
from firmware_py.safety.limits import Limits
from firmware_py.safety.supervisor import check_motion
from models.gap.estimation.nuisance_fit import nuisance_fit_of
from models.gap.experiment.rival import HypothesisRecord
from models.gap.experiment.separation import REST_SAMPLES, SeparationModel
from models.gap.residuals.fit_parameters import candidate_effects
from models.gap.search.effect_search import ReportProgress
from models.gap.settings import DEFAULT_SETTINGS, GapSettings
from models.plant.plant import Plant
from models.plant.step_model import Array
from models.trials.trial import Trial, TrialMeta, TrialSet

SEPARATED: Final = 3.0
"""d′ above which two hypotheses count as separated (docs/sources.md, "Naming a missing effect")."""
VARIATIONS: Final = ((1.0, 1.0), (0.5, 1.0), (1.0, 2.0), (0.5, 0.5))
"""Amplitudes and periods of the motions, as multiples of those of the trials [assumed]."""
SWAPPED_PAYLOAD_KG: Final = 2.0
"""Payload that is tried beside those of the trials; none if they carried more than half of it
[assumed]."""
USUAL_LIMITS: Final = Limits(rate_rad_s=UNWATCHED_RATE_RAD_S)
"""Limits where those of the robot are not known: the defaults, at a rate for any servo."""
LONGEST_S: Final = 60.0
"""Longest motion that is offered [assumed]."""
TWIN_MARGIN: Final = 0.85
"""Fraction of a limit of current and following error that the twin may use; the rest covers the
difference between twin and robot [assumed]."""
TIP_MARGIN: Final = 0.98
"""The same for the tip, where this difference is some millimetres [assumed]."""


@dataclass(frozen=True)
class RankedMotion:
    """Motion that the limits allow with a payload, and what its trial would add."""

    motion: Motion
    payload_kg: float
    separations: tuple[float, ...]  # d′ of each pair with its trial added
    least_gain: float  # Least d′ that it adds, over the pairs that some motion separates

    @property
    def label(self) -> str:
        return ", ".join([self.motion.kind, *_size(self.motion)])

    @property
    def separated(self) -> int:
        """Number of pairs that it separates."""
        return sum(d >= SEPARATED for d in self.separations)


@dataclass(frozen=True)
class Experiment:
    """Motions by how well they separate the hypotheses, the best first."""

    rivals: tuple[HypothesisRecord, ...]
    pairs: tuple[str, ...]  # Pairs of rivals in words
    before: tuple[float, ...]  # d′ of each pair on the trials at hand
    ranked: tuple[RankedMotion, ...]
    limits: Limits

    @property
    def best(self) -> RankedMotion:
        return self.ranked[0]

    @property
    def together(self) -> list[str]:
        """Pairs that the best motion does not separate."""
        both = zip(self.pairs, self.best.separations, strict=True)
        return [pair for pair, d in both if d < SEPARATED]


def rank_motions(
    rivals: Sequence[HypothesisRecord], plant: Plant, trials: TrialSet, limits: Limits,
    payloads_kg: Sequence[float] = (), report: ReportProgress = lambda text, further: None,
    settings: GapSettings = DEFAULT_SETTINGS,
) -> Experiment:  # fmt: skip
    """Rank motions and payloads by the pairs that they separate, then by the least gain."""
    _check(rivals, plant, trials, payloads_kg)
    planned = planned_motions(trials, payloads_kg or default_payloads_kg(trials), limits)
    # The rival that is refitted is the second one, with no more effects than the first
    pairs = [
        (a, b) if len(rivals[a].effects) >= len(rivals[b].effects) else (b, a)
        for a, b in combinations(range(len(rivals)), 2)
    ]
    catalogue = candidate_effects(plant)
    nuisance = nuisance_fit_of(plant, trials.trials, catalogue, settings.same_link)
    model = SeparationModel(nuisance, rivals, pairs)
    report("trials at hand judged", len(planned))
    allowed = allowed_motions(model, planned, limits, report)
    if not allowed:
        raise InputError(
            "--config", "its limits allow none of the motions in simulation",
            "widen those of tip, current or following error, or choose other --payloads",
        )  # fmt: skip
    separated = np.array([row for *_, row in allowed]) >= SEPARATED
    counted = separated.any(axis=0) | ~separated.any()
    ranked = [
        RankedMotion(*of_motion, float(model.added(of_motion[-1])[counted].min()))
        for of_motion in allowed
    ]
    ranked.sort(key=lambda r: (-r.separated, -r.least_gain))
    return Experiment(
        tuple(rivals),
        tuple(f"{rivals[a].label} or {rivals[b].label}" for a, b in pairs),
        model.before,
        tuple(ranked),
        limits,
    )


def allowed_motions(
    model: SeparationModel, planned: Sequence[tuple[Motion, float]], limits: Limits,
    report: ReportProgress = lambda text, further: None,
) -> list[tuple[Motion, float, tuple[float, ...]]]:  # fmt: skip
    """Planned motions and payloads whose simulation stays within the limits at every hypothesis.

    Each with the d′ of every pair with its trial added.
    """
    allowed = []
    for k, (motion, payload_kg) in enumerate(planned, 1):
        run = model.planned_run(motion, payload_kg)
        if all(twin_keeps(limits, run.outputs(v), run.trials[0]) for v in model.values):
            allowed.append((motion, payload_kg, model.separations(run)))
        report(f"{motion.kind} with {payload_kg:g} kg tried", len(planned) - k)
    return allowed


def _check(
    rivals: Sequence[HypothesisRecord], plant: Plant, trials: TrialSet, payloads_kg: Sequence[float]
) -> None:
    """Refuse inputs that no motion can be ranked for."""
    if plant.load != "link":
        raise InputError(
            f"plant {plant.name!r}", "is not the link", "motions are ranked for the link alone"
        )
    if len(rivals) < 2:
        raise InputError(
            "gap.json",
            "holds no two hypotheses to separate; one that adds an effect to another counts as it",
            "where gap asks for an experiment, record another motion or payload",
        )
    most_kg = max(2 * max(t.meta.payload_kg for t in trials), SWAPPED_PAYLOAD_KG)
    for payload_kg in payloads_kg:
        if not 0 <= payload_kg <= most_kg:
            raise InputError(
                f"--payloads {payload_kg:g}", "is a payload that no trial comes near",
                f"choose 0 to {most_kg:g} kg",
            )  # fmt: skip


def default_payloads_kg(trials: TrialSet) -> tuple[float, ...]:
    """Lightest, middle and heaviest payload of the trials, and one that swaps the payload."""
    known = sorted({t.meta.payload_kg for t in trials})
    return tuple(sorted({known[0], known[len(known) // 2], known[-1], _swapped_kg(known[-1])}))


def _swapped_kg(heaviest_kg: float) -> float:
    return SWAPPED_PAYLOAD_KG if heaviest_kg <= SWAPPED_PAYLOAD_KG / 2 else 0.0


def usual_motions(trials: TrialSet) -> list[tuple[Motion, float]]:
    """Motions with amplitude and period of the trials, with the heaviest payload and swapped."""
    heaviest_kg = max(t.meta.payload_kg for t in trials)
    payloads_kg = (heaviest_kg, _swapped_kg(heaviest_kg))
    return planned_motions(trials, payloads_kg, USUAL_LIMITS, VARIATIONS[:1])


def planned_motions(
    trials: TrialSet,
    payloads_kg: Sequence[float],
    limits: Limits,
    variations: Sequence[tuple[float, float]] = VARIATIONS,
) -> list[tuple[Motion, float]]:
    """Motions that the limits of the goals allow, with each payload.

    One that was already run with a payload is left out: a repetition has the same error of the
    plant, so it adds little, and the floor of a planned trial does not account for that.
    """
    meta, result, refused = trials[0].meta, [], "all were run already"
    at_hand = {(t.meta.motion, *_size(t.meta), t.meta.payload_kg) for t in trials}
    for kind, (larger, slower) in product(KINDS, variations):
        try:
            motion = Motion(
                kind, larger * meta.amplitude_rad, slower * meta.period_s, meta.phase_2_rad,
                meta.dof,
            )  # fmt: skip
            check_motion(motion.table_rad(rest_samples=REST_SAMPLES), limits, PERIOD_S, kind)
        except InputError as error:
            refused = f"{error.where}: {error.what}"
            continue
        if motion.duration_s <= LONGEST_S:
            result += [(motion, p) for p in payloads_kg if (kind, *_size(motion), p) not in at_hand]
    if not result:
        raise InputError(
            "--config", f"its limits leave no motion to try ({refused})",
            "widen [limits], or choose other --payloads",
        )  # fmt: skip
    return result


def _size(motion: Motion | TrialMeta) -> tuple[str, str]:
    return ANGLE.text(motion.amplitude_rad), f"period {motion.period_s:.3g} s"


def twin_keeps(limits: Limits, outputs: Mapping[str, Array], trial: Trial) -> bool:
    """Whether current, following error and tip of the twin stay within their limits with a margin.

    A signal that already exceeds the margin at rest may use half of the remaining distance to its
    limit.
    """
    used: list[tuple[Array, float]] = []
    for j, goal_rad in enumerate(trial.goal_rad.T, 1):
        error_rad = outputs[f"angle_{j}_rad"] - goal_rad
        used.append((error_rad / limits.following_error_rad, TWIN_MARGIN))
        used.append((outputs[f"current_{j}_a"] / limits.current_a, TWIN_MARGIN))
    for axis, low_m, high_m in zip("xyz", limits.tip_min_m, limits.tip_max_m, strict=True):
        middle_m, half_m = (low_m + high_m) / 2, (high_m - low_m) / 2
        used.append(((outputs[f"tip_{axis}_m"] - middle_m) / half_m, TIP_MARGIN))
    return all(
        np.abs(fraction).max() <= (max(margin, (1 + rest) / 2) if rest < 1 else margin)
        for fraction, margin in used
        for rest in (abs(fraction[0]),)
    )


MOST_PAIRS: Final = 6
"""Pairs that the console lists [assumed]."""


def experiment_in_words(experiment: Experiment, motion: Path) -> str:
    """Text on the best motion: what it separates, and what it does not."""
    best, count = experiment.best, len(experiment.pairs)
    lines = [f"{motion}: {best.label}; attach {best.payload_kg:g} kg"]
    rows = list(zip(experiment.pairs, experiment.before, best.separations, strict=True))
    lines += [f"  {pair}: d′ {a:.1f} now, {b:.1f} with it" for pair, a, b in rows[:MOST_PAIRS]]
    if count > MOST_PAIRS:
        lines.append(f"  and {count - MOST_PAIRS} more pairs, see the page")
    lines.append(
        f"best of {len(experiment.ranked)} motions and payloads within the limits; "
        f"it adds a least d′ of {best.least_gain:.1f}"
    )
    if experiment.together:
        lines.append(f"it does not separate {len(experiment.together)} of {count} pairs")
    return "\n".join(lines)


def write_motion(best: RankedMotion, path: Path) -> None:
    """Write the file for `dropstitch run --motion`."""
    motion = best.motion
    document = MotionDocument(
        schema=MotionDocument.VERSION, kind=motion.kind,
        amplitude_rad=motion.amplitude_rad, period_s=motion.period_s,
        phase_2_rad=motion.phase_2_rad, payload_kg=best.payload_kg,
    )  # fmt: skip
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, tomli_w.dumps(msgspec.to_builtins(document)).encode())
