"""Next experiment: hypotheses of a diagnosis, the motion that separates them, and by how much."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import tomli_w

from firmware_py.errors import InputError
from firmware_py.files.output_files import write_whole
from firmware_py.motion import Motion
from firmware_py.motion_document import MotionDocument
from firmware_py.safety.limits import Limits
from firmware_py.safety.supervisor import check_motion
from firmware_py.signals import PERIOD_S
from models.gap.estimation.model_discrepancy import ModelDiscrepancy
from models.gap.experiment.motion_design import Design, MotionDesigner
from models.gap.experiment.motion_limits import REST_SAMPLES
from models.gap.experiment.rival import Rival
from models.gap.experiment.separation import PairSeparation, SeparationModel
from models.gap.fixed_motions import MENU, motion_like, planned_trial
from models.gap.search.effect_search import ReportProgress
from models.gap.settings import DEFAULT_SETTINGS, GapSettings
from models.plant.plant import Plant
from models.trials.trial import TrialSet


@dataclass(frozen=True)
class FixedMotion:
    """Motion of the menu that the limits allow, and how well it separates the hypotheses."""

    label: str
    motion: Motion  # With amplitude, period and phase
    payload_kg: float
    pairs: tuple[PairSeparation, ...]  # In the order of the experiment's pairs


@dataclass(frozen=True)
class Experiment:
    """Designed motion, and the motions of the menu for comparison."""

    rivals: tuple[Rival, ...]
    pairs: tuple[tuple[int, int], ...]
    design: Design
    fixed: tuple[FixedMotion, ...]
    limits: Limits
    least_separation: float  # d′ above which two hypotheses count as separated

    @property
    def separable(self) -> tuple[int, ...]:
        """Indices of the pairs that at least one of these motions separates."""
        every = [self.design.pairs, *(f.pairs for f in self.fixed)]
        return tuple(
            k for k in range(len(self.pairs))
            if max(own[k].separation for own in every) >= self.least_separation
        )  # fmt: skip

    @property
    def best_fixed(self) -> FixedMotion | None:
        """Motion of the menu that separates most."""
        return max(self.fixed, key=lambda f: self._separated(f.pairs), default=None)

    @property
    def better_fixed(self) -> FixedMotion | None:
        """Best motion of the menu if it separates more than the designed one.

        The plant's own error is known on motions that the plant was identified on, and unknown on a
        designed one, so such a motion may separate more with another payload.
        """
        best = self.best_fixed
        if best is None or self._separated(best.pairs) <= self._separated(self.design.pairs):
            return None
        return best

    @property
    def recommended(self) -> tuple[Motion, float]:
        """Motion to run, and its payload in kg: the designed one unless a fixed one is better."""
        if (fixed := self.better_fixed) is not None:
            return fixed.motion, fixed.payload_kg
        document = self.design.document
        return Motion.designed(document), document.payload_kg or 0.0

    def _separated(self, pairs: Sequence[PairSeparation]) -> tuple[int, float]:
        """Rank of a motion: number of separated pairs, then the least gain."""
        count = sum(q.separation >= self.least_separation for q in pairs)
        return count, self.least_gain(pairs)

    def least_gain(self, pairs: Sequence[PairSeparation]) -> float:
        """Least d′ that a motion adds to the present trials, over the separable pairs."""
        counted = self.separable or range(len(self.pairs))
        return min(pairs[k].gained for k in counted)

    def label(self, pair: int) -> str:
        """Names of a pair."""
        a, b = self.pairs[pair]
        return f"{self.rivals[a].label} or {self.rivals[b].label}"

    def together(self) -> list[str]:
        """Pairs that the recommended motion does not separate."""
        fixed = self.better_fixed
        pairs = fixed.pairs if fixed else self.design.pairs
        return [self.label(k) for k, q in enumerate(pairs) if q.separation < self.least_separation]


def design_experiment(
    rivals: Sequence[Rival], plant: Plant, trials: TrialSet, limits: Limits, seconds: float,
    payloads_kg: Sequence[float] = (), seed: int = 0,
    report: ReportProgress = lambda text, further: None, settings: GapSettings = DEFAULT_SETTINGS,
    patterns: Sequence[ModelDiscrepancy] = (),
) -> Experiment:  # fmt: skip
    """Design the motion that best separates the hypotheses of a diagnosis."""
    _check(rivals, plant, trials, limits, seconds, payloads_kg, settings)
    model = SeparationModel(plant, trials.trials, rivals, settings, patterns)
    report("trials at hand judged", 3)
    payloads = tuple(payloads_kg) or default_payloads_kg(trials)
    designer = MotionDesigner(model, limits, seconds, seed, report)
    fixed = _fixed_motions(designer, payloads, {(t.meta.motion, t.meta.payload_kg) for t in trials})
    report("fixed motions tried", 2)
    design = designer.design(payloads)
    rows = Motion.designed(design.document).table_rad(rest_samples=REST_SAMPLES)
    check_motion(rows, limits, PERIOD_S, "the designed motion")
    least = settings.indistinguishable_separation
    return Experiment(tuple(rivals), tuple(model.pairs), design, fixed, limits, least)


def _check(
    rivals: Sequence[Rival], plant: Plant, trials: TrialSet, limits: Limits, seconds: float,
    payloads_kg: Sequence[float], settings: GapSettings,
) -> None:  # fmt: skip
    """Refuse inputs that no motion can be designed for."""
    if plant.load != "link":
        raise InputError(
            f"plant {plant.name!r}", "is not the link", "motions are designed for the link alone"
        )
    if not 2.0 <= seconds <= 120.0:
        raise InputError("--seconds", f"is {seconds:g}", "choose 2 to 120")
    if len(rivals) < 2:
        raise InputError(
            "gap.json",
            "holds no two hypotheses to separate; one that adds an effect to another counts as it",
            "no motion is designed: where gap asks for one, record another motion or payload",
        )
    low_rad, high_rad = limits.angle_rad
    if not low_rad < 0 < high_rad:
        raise InputError(
            "limits.angle_rad", f"is {low_rad:g} to {high_rad:g}, without 0",
            "a designed motion begins and ends at 0: give limits on both sides of it",
        )  # fmt: skip
    most = max(2 * max(t.meta.payload_kg for t in trials), settings.swapped_payload_kg)
    for payload_kg in payloads_kg:
        if not 0 <= payload_kg <= most:
            raise InputError(
                f"--payloads {payload_kg:g}", "is a payload that no trial comes near",
                f"choose 0 to {most:g} kg",
            )  # fmt: skip


def default_payloads_kg(trials: TrialSet) -> tuple[float, ...]:
    """Lightest and middle payload of the trials.

    On a new motion the plant's own error grows with payload. Measured on the rig with nothing
    hidden, a designed motion of up to 1 Hz, tip: 1.7 noise floors with 1 kg, 7.6 with 2 kg.
    """
    known = sorted({t.meta.payload_kg for t in trials})
    return tuple(sorted({known[0], known[len(known) // 2]}))


def _fixed_motions(
    designer: MotionDesigner,
    payloads_kg: Sequence[float],
    at_hand: Collection[tuple[str, float]],
) -> tuple[FixedMotion, ...]:
    """Motions of the menu that the limits allow with a payload, also when the twin runs them.

    A motion that was already run with a payload is left out: a repetition has the same error of the
    plant, so it adds little, and the floor of a planned trial does not account for that.
    """
    model, found = designer.model, []
    meta = model.like.meta
    for label, kind in MENU.items():
        if label == "payload swap":  # every motion is tried with every payload
            label = "sinusoid"
        try:
            motion = motion_like(meta, kind)
            rows = motion.table_rad(rest_samples=REST_SAMPLES)
            check_motion(rows, designer.limits, PERIOD_S, label)
        except InputError:
            continue
        for payload_kg in payloads_kg:
            if (motion.name, payload_kg) in at_hand:
                continue
            trial = planned_trial(model.like, motion, payload_kg, meta.rest_samples)
            if designer.excess_of(trial) > 0:
                continue
            found.append(FixedMotion(label, motion, payload_kg, tuple(model.separations(trial))))
    return tuple(found)


def experiment_in_words(found: Experiment, motion: Path) -> str:
    """Text on what the motion separates."""
    document, best = found.design.document, found.best_fixed
    lines = [
        f"{motion}: {document.duration_s:g} s, up to {document.amplitude_rad:.3f} rad, "
        f"with {document.payload_kg:g} kg at the tip"
    ]
    for k, own in enumerate(found.design.pairs):
        fixed = f", {best.pairs[k].separation:.1f} with {best.label}" if best else ""
        lines.append(
            f"  {found.label(k)}: d′ {own.before:.1f} now, {own.separation:.1f} with it{fixed}"
        )
    if best is not None:
        gain, rival = found.least_gain(found.design.pairs), found.least_gain(best.pairs)
        lines.append(
            f"it adds a least d′ of {gain:.1f}; the best fixed motion within the limits "
            f"({best.label}, {best.payload_kg:g} kg) adds {rival:.1f}"
        )
    lines += [f"run {better_fixed_in_words(fixed)}" for fixed in (found.better_fixed,) if fixed]
    lines += [f"it does not separate {pair}" for pair in found.together()]
    return "\n".join(lines)


def better_fixed_in_words(fixed: FixedMotion) -> str:
    """Instruction to run a fixed motion that separates more than the designed one."""
    motion = fixed.motion
    return (
        f"the {fixed.label} with {fixed.payload_kg:g} kg in its place, it separates more: [motion] "
        f'kind = "{motion.kind}", amplitude_rad = {motion.amplitude_rad:.4f}, '
        f"period_s = {motion.period_s:g}, phase_2_rad = {motion.phase_2_rad:g} in robot.toml"
    )


def write_motion(document: MotionDocument, path: Path) -> None:
    entries = {k: v for k, v in msgspec.to_builtins(document).items() if v is not None}
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, tomli_w.dumps(entries).encode())
