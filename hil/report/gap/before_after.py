"""Figures before and after a gap was closed: identified effects, errors of FMUs and robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import msgspec
import numpy as np

from firmware_py.core.units import FRACTION, LENGTH, PAYLOAD
from hil.report.build_inputs import LoopRun
from hil.report.gap.gap_inputs import GapInputs
from hil.sil.timing_document import TipErrors
from models.gap.report.gap_json import GapDocument, NamedEffect
from models.plant.identification.evaluation import TIP, compare_with_trials
from models.plant.plant import Plant
from models.shared.catalogue import effect_and_joint

PART: Final = "motion"
"""Part of the robot's programme that is judged; training contains neither rest nor glide."""
SMALLEST_GAP: Final = 1.1
"""Ratio of the error before to the error without the effect up to which the gap is too small for
a fraction."""

ByVariant = dict[str, float | None]
"""Value by variant of the FMU or bundle: before, retrained, after, without."""


class HiddenEffect(msgspec.Struct, frozen=True):
    """Effect that was hidden, and the diagnosis of it."""

    hidden: float  # Hidden strength
    found: float | None  # Estimated change of the strength
    error: float | None  # Standard error of the estimate
    said: str  # Result as text


class FmuErrors(msgspec.Struct, frozen=True):
    """Errors of the twin FMUs on the sealed trials."""

    tip_rms_m: ByVariant  # RMS distance between simulated and measured tip
    fraction_removed: float | None  # Fraction of the gap that was removed
    worst_difference: float  # Largest difference from the plants in Python, SI units
    passed: bool  # Whether the rebuilt twin passed `dropstitch fmu check`


class RobotErrors(msgspec.Struct, frozen=True):
    """Errors of the robot's prediction in motion, and the coverage of its interval."""

    tip_mean_m: ByVariant  # Mean distance between predicted and true tip
    fraction_removed: float | None  # Fraction of the gap that was removed
    # Fraction of ticks inside the 95 % interval, mean over the axes that move
    interval_coverage: ByVariant


class BeforeAfter(msgspec.Struct, frozen=True):
    """Figures of the page, which `dropstitch report gap --json` prints too."""

    verdict: str  # Verdict of the diagnosis
    hidden: dict[str, HiddenEffect]
    also_named: list[str]  # Effects that were named without being hidden
    fmu: FmuErrors
    robot: RobotErrors  # Errors over all payloads
    robot_heaviest: RobotErrors  # Errors at the heaviest payload
    heaviest_kg: float  # Heaviest payload
    # RMS path error of a plan at the heaviest payload; `rigid` is a plan by rigid kinematics
    path_rms_m: ByVariant


def before_after(inputs: GapInputs, hidden: Mapping[str, float]) -> BeforeAfter:
    """Compute all figures, in SI units."""
    tip_rms_m: ByVariant = {
        variant: _distance_rms([run.rms[axis] for run in runs.values() for axis in TIP])
        for variant, runs in inputs.fmus.items()
    }
    heaviest_kg = max(inputs.loops["before"])
    effects = {effect_and_joint(name)[0] for name in hidden}
    return BeforeAfter(
        verdict=inputs.found.verdict,
        hidden={effect: _hidden_effect(inputs, effect, s) for effect, s in hidden.items()},
        also_named=[e for e in named_in(inputs.found) if e not in effects],
        fmu=FmuErrors(
            tip_rms_m=tip_rms_m,
            fraction_removed=fraction_removed(tip_rms_m),
            worst_difference=max(_difference(inputs, v) for v in ("before", "after")),
            passed=inputs.check.passed,
        ),
        robot=_robot_errors(inputs, sorted(inputs.loops["before"])),
        robot_heaviest=_robot_errors(inputs, [heaviest_kg]),
        heaviest_kg=heaviest_kg,
        path_rms_m=dict(inputs.path_rms_m),
    )


def fraction_removed(error: Mapping[str, float | None]) -> float | None:
    """Return (before − after)/(before − without), the fraction of the gap that was removed.

    None if the gap is no more than a tenth of the error without the effect, or an error is missing.
    """
    before, after, without = (error.get(v) for v in ("before", "after", "without"))
    if before is None or after is None or without is None or before <= SMALLEST_GAP * without:
        return None
    return (before - after) / (before - without)


def judged_part(loop: LoopRun) -> TipErrors | None:
    """Return the prediction error in the part that is judged; None if the run lacks it."""
    return loop.timing.prediction_error.parts.get(PART)


def named_in(found: GapDocument) -> dict[str, NamedEffect]:
    """Row of gap.json for every named effect."""
    return {row.effect: row for row in found.named}


def describe_before_after(data: BeforeAfter) -> str:
    """Return the figures as text for a console."""
    lines = ["; ".join(row.said for row in data.hidden.values()) or "no effect was hidden"]
    lines += [f"{name} was named too" for name in data.also_named]
    robot, heaviest = data.robot, data.robot_heaviest
    lines += [
        "twin in FMPy, tip RMS: " + _by_variant(data.fmu.tip_rms_m, data.fmu.fraction_removed),
        f"  {same_in_python(data.fmu.worst_difference)}",
        "robot, predicted tip: " + _by_variant(robot.tip_mean_m, robot.fraction_removed),
        f"  at {PAYLOAD.significant(data.heaviest_kg)}: "
        + _by_variant(heaviest.tip_mean_m, heaviest.fraction_removed),
    ]
    if data.path_rms_m:
        lines.append("tip off its path, RMS: " + _by_variant(data.path_rms_m, None))
    return "\n".join(lines)


def same_in_python(worst: float) -> str:
    """Describe how well FMUs in FMPy agree with plants in Python, by their largest difference."""
    if worst == 0.0:
        return "bit for bit equal to the plants in Python"
    return f"within {worst:.0e} (SI units) of the plants in Python"


def _by_variant(error: Mapping[str, float | None], fraction: float | None) -> str:
    said = ", ".join(f"{LENGTH.text(e)} {v}" for v, e in error.items() if e is not None)
    return said + ("" if fraction is None else f"; {FRACTION.text(fraction)} of the gap removed")


def _robot_errors(inputs: GapInputs, payloads: Sequence[float]) -> RobotErrors:
    judged = {
        variant: [judged_part(loops[kg]) if kg in loops else None for kg in payloads]
        for variant, loops in inputs.loops.items()
    }
    mean_m = {v: _mean(rows, "mean_euclidean_distance_m") for v, rows in judged.items()}
    return RobotErrors(
        tip_mean_m=mean_m,
        fraction_removed=fraction_removed(mean_m),
        interval_coverage={v: _mean(r, "interval_coverage") for v, r in judged.items()},
    )


def _hidden_effect(inputs: GapInputs, hidden: str, strength: float) -> HiddenEffect:
    effect, joint = effect_and_joint(hidden)
    words = effect.replace("_", " ") + (f" of joint {joint}" if joint else "")
    if row := named_in(inputs.found).get(effect):
        strengths = inputs.after.strengths(effect, inputs.trials[0].meta.dof)
        # Without a joint, all joints have the same strength.
        q = row.parameters[strengths[(row.joint or joint or 1) - 1]]
        found, error = q.value - q.before, q.error
        said = f"{words}: {strength:g} hidden, {found:.3g} ± {error or 0.0:.1g} found"
        return HiddenEffect(strength, found, error, said)
    for name, other in named_in(inputs.found).items():
        alike = [effect_and_joint(e)[0] for own in other.look_alikes for e in own.effects]
        if effect in alike:
            instead = name.replace("_", " ")
            said = f"{words} was hidden; its look-alike {instead} was named"
            return HiddenEffect(strength, None, None, said)
    return HiddenEffect(strength, None, None, f"{words} was hidden and not named")


def _difference(inputs: GapInputs, variant: str) -> float:
    """Largest difference of an FMU in FMPy from its plant in Python, over all trials and signals.

    It mixes amperes, radians and metres: an error would be far larger than rounding in any of them.
    """
    plant: Plant = getattr(inputs, variant)
    worst = 0.0
    for row in compare_with_trials(plant, inputs.sealed):
        run = inputs.outputs[variant].get(row.trial.meta.payload_kg)
        for signal, values in row.simulated.items():
            if run is not None and signal in (run.dtype.names or ()):
                worst = max(worst, float(np.max(np.abs(run[signal] - values))))
    return worst


def _distance_rms(axis_rms: Sequence[float]) -> float:
    """RMS distance, computed from the RMS values of its coordinates."""
    return float(np.sqrt(len(TIP) * np.mean(np.square(axis_rms))))


def _mean(rows: Sequence[TipErrors | None], field: str) -> float | None:
    """Mean of a field over the runs; None if one of them lacks the judged part."""
    values = [getattr(row, field) for row in rows if row is not None]
    return float(np.mean(values)) if values and len(values) == len(rows) else None
