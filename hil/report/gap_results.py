"""A closed gap: the files that `make gap-demo` writes, and the errors before and after.

::

    trials/                     dropstitch simulate --hide …      for the diagnosis
    sealed/                     the same on another motion              held out from all fits
    found/gap.json, plant.json  dropstitch gap
    check_twin_1dof.json        dropstitch fmu check … --json            of the rebuilt FMU
    fmpy_VARIANT_PAYLOAD.json   dropstitch fmu simulate … --json         and …/result.csv
    sil_VARIANT_PAYLOAD/        dropstitch sil --rig --hide …
    plan_VARIANT/               dropstitch sil --rig --hide … --plan    (may be absent)
    commands.log                make gap-demo

Variants:

- `before` and `after` the diagnosis.
- `without` the effect, with FMU and bundle as in `before`: the smallest possible error.
- `retrained` (loop only), on the same trials as `after` with the plant of `before`: the effect of
  new data alone.
- `rigid` (plans only): goals by rigid kinematics.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from firmware_py.core.units import FRACTION, LENGTH, PAYLOAD, DisplayUnit, error_unit
from hil.report.build_inputs import (
    FmuCheckOutput,
    LoopRun,
    read_commands,
    read_loop,
    read_output,
)
from hil.sil.timing_document import TipErrors
from models.gap.report.gap_json import (
    FittedValue,
    GapDocument,
    NamedEffect,
    read_gap_document,
)
from models.plant.identification.evaluation import TIP, compare_with_trials
from models.plant.plant import Plant, read_plant
from models.shared.catalogue import effect_and_joint
from models.trials.files import read_trials
from models.trials.trial import TrialSet

T = TypeVar("T")

MADE_BY: Final = "run 'make gap-demo'"
VARIANTS: Final = ("before", "retrained", "after", "without")
PLAN_VARIANTS: Final = ("rigid", "before", "after", "without")
PART: Final = "motion"
"""Part of the robot's programme that is judged; training contains neither rest nor glide."""
SMALLEST_GAP: Final = 1.1
"""Ratio of the error before to the error without the effect up to which the gap is too small for
a fraction."""

ByVariant = dict[str, float | None]
ByPayload = dict[float, T]


class FmuRunOutput(msgspec.Struct, frozen=True):
    """Output of `dropstitch fmu simulate --json` on a trial."""

    rms: dict[str, float]  # RMS error by signal, SI units
    units: dict[str, str]  # SI unit of each signal


@dataclass(frozen=True)
class GapInputs:
    """Files of a closed gap."""

    diagnosis: GapDocument
    before: Plant  # Plant before the diagnosis
    after: Plant  # Plant after the diagnosis
    trials: TrialSet  # Trials of the diagnosis
    sealed: TrialSet  # Held-out trials, to which no value was fitted
    check: FmuCheckOutput  # Check of the rebuilt twin
    fmus: dict[str, ByPayload[FmuRunOutput]]  # Runs of each variant's FMU, by payload in kg
    # Rows of result.csv of those runs, with columns as fields
    outputs: dict[str, ByPayload[NDArray[np.void]]]
    loops: dict[str, ByPayload[LoopRun]]  # Runs of each variant's loop, by payload in kg
    # RMS path error of a plan, by variant; empty if no plan was run
    path_rms_m: dict[str, float]
    commands: list[str]  # Commands that wrote the files


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


def read_gap(directory: Path, plant: Path) -> GapInputs:
    """Read the directory and the plant before the diagnosis."""
    for needed in ("found/gap.json", "check_twin_1dof.json"):
        if not (directory / needed).is_file():
            raise InputError(directory / needed, "is missing", MADE_BY)
    before = read_plant(plant)
    return GapInputs(
        diagnosis=read_gap_document(directory / "found" / "gap.json"),
        before=before,
        after=read_plant(directory / "found" / "plant.json"),
        trials=read_trials(directory / "trials", before.signals),
        sealed=read_trials(directory / "sealed", before.signals),
        check=read_output(directory / "check_twin_1dof.json", FmuCheckOutput),
        fmus=_runs(directory, "fmpy", ".json", lambda path: read_output(path, FmuRunOutput)),
        outputs=_runs(
            directory, "fmpy", "/result.csv",
            lambda path: np.asarray(np.genfromtxt(path, delimiter=",", names=True)),
        ),
        loops=_runs(directory, "sil", "/timing.json", lambda path: read_loop(path.parent)),
        path_rms_m={
            variant: errors[-1].rms_m
            for variant in PLAN_VARIANTS
            if (path := directory / f"plan_{variant}").is_dir()
            and (errors := read_loop(path).timing.path_errors)
        },
        commands=read_commands(directory / "commands.log"),
    )  # fmt: skip


def _runs(
    directory: Path, kind: str, tail: str, read: Callable[[Path], T]
) -> dict[str, ByPayload[T]]:
    """Read a file of each run, by variant and payload; `before` and `after` are required."""
    name = re.compile(rf"{kind}_({'|'.join(VARIANTS)})_(\d+(?:\.\d+)?){re.escape(tail)}")
    paths: dict[str, ByPayload[Path]] = {variant: {} for variant in VARIANTS}
    for path in directory.glob(f"{kind}_*{tail}"):
        if match := name.fullmatch(path.relative_to(directory).as_posix()):
            paths[match[1]][float(match[2])] = path
    payloads = sorted(paths["before"] | paths["after"])
    missing = [(v, kg) for v in ("before", "after") for kg in payloads if kg not in paths[v]]
    if missing or not payloads:
        variant, kg = missing[0] if missing else ("before", 0.0)
        raise InputError(directory / f"{kind}_{variant}_{kg:g}{tail}", "is missing", MADE_BY)
    return {
        variant: {kg: read(of_variant[kg]) for kg in sorted(of_variant)}
        for variant, of_variant in paths.items()
        if of_variant
    }


def before_after(inputs: GapInputs, hidden: Mapping[str, float]) -> BeforeAfter:
    """Compute all figures, in SI units."""
    tip_rms_m: ByVariant = {
        # From the RMS values of the coordinates
        variant: float(
            np.sqrt(len(TIP) * np.mean([run.rms[a] ** 2 for run in runs.values() for a in TIP]))
        )
        for variant, runs in inputs.fmus.items()
    }
    payloads = sorted(inputs.loops["before"])
    effects = {effect_and_joint(name)[0] for name in hidden}
    return BeforeAfter(
        verdict=inputs.diagnosis.verdict,
        hidden={effect: _hidden_effect(inputs, effect, s) for effect, s in hidden.items()},
        also_named=[row.effect for row in inputs.diagnosis.named if row.effect not in effects],
        fmu=FmuErrors(
            tip_rms_m=tip_rms_m,
            fraction_removed=fraction_removed(tip_rms_m),
            worst_difference=max(
                _difference(plant, inputs.sealed, inputs.outputs[variant])
                for variant, plant in (("before", inputs.before), ("after", inputs.after))
            ),
            passed=inputs.check.passed,
        ),
        robot=_robot_errors(inputs, payloads),
        robot_heaviest=_robot_errors(inputs, payloads[-1:]),
        heaviest_kg=payloads[-1],
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


def _robot_errors(inputs: GapInputs, payloads: Sequence[float]) -> RobotErrors:
    judged = {
        variant: [judged_part(loops[kg]) if kg in loops else None for kg in payloads]
        for variant, loops in inputs.loops.items()
    }
    mean_m = {v: _mean(rows, "mean_euclidean_distance_m") for v, rows in judged.items()}
    return RobotErrors(
        tip_mean_m=mean_m,
        fraction_removed=fraction_removed(mean_m),
        interval_coverage={v: _mean(rows, "interval_coverage") for v, rows in judged.items()},
    )


def _mean(rows: Sequence[TipErrors | None], field: str) -> float | None:
    """Mean of a field over the runs; None if one of them lacks the judged part."""
    values = [getattr(row, field) for row in rows if row is not None]
    return float(np.mean(values)) if values and len(values) == len(rows) else None


def _hidden_effect(inputs: GapInputs, hidden: str, strength: float) -> HiddenEffect:
    effect, joint = effect_and_joint(hidden)
    words = effect.replace("_", " ") + (f" of joint {joint}" if joint else "")
    named = {row.effect: row for row in inputs.diagnosis.named}
    if row := named.get(effect):
        strengths = inputs.after.strengths(effect, inputs.trials[0].meta.dof)
        # Without a joint, all joints have the same strength.
        q = row.parameters[strengths[(row.joint or joint or 1) - 1]]
        change = q.value - q.before
        unit = error_unit(q.unit)
        text = f"{words}: {unit.significant(strength)} hidden, {_estimate(q, unit)} estimated"
        return HiddenEffect(strength, change, q.error, text)
    text = f"{words} was hidden and not named"
    if alike := [name for name, row in named.items() if effect in _look_alikes(row)]:
        look_alike = alike[0].replace("_", " ")
        text = f"{words} was hidden; its look-alike {look_alike} was named"
    return HiddenEffect(strength, None, None, text)


def _estimate(q: FittedValue, unit: DisplayUnit) -> str:
    """Estimated change of a strength, with its standard error if it has one."""
    error = "" if q.error is None else f" ± {unit.factor * q.error:.2g}"
    return f"{unit.factor * (q.value - q.before):.3g}{error} {unit.name}".strip()


def _look_alikes(row: NamedEffect) -> set[str]:
    return {effect_and_joint(e)[0] for group in row.look_alikes for e in group.effects}


def _difference(plant: Plant, trials: TrialSet, runs: ByPayload[NDArray[np.void]]) -> float:
    """Largest difference of an FMU in FMPy from its plant in Python, over all trials and signals.

    It mixes amperes, radians and metres: an error would be far larger than rounding in any of them.
    """
    worst = 0.0
    for row in compare_with_trials(plant, trials):
        run = runs.get(row.trial.meta.payload_kg)
        for signal, values in row.simulated.items():
            if run is not None and signal in (run.dtype.names or ()):
                worst = max(worst, float(np.max(np.abs(run[signal] - values))))
    return worst


def hidden_and_named(data: BeforeAfter) -> str:
    """Which of the hidden effects were named, and what was named beside them."""
    results = [row.said for row in data.hidden.values()] or ["no effect was hidden"]
    results += [f"{e.replace('_', ' ')} was named without being hidden" for e in data.also_named]
    text = "; ".join(results)
    return f"{text[0].upper()}{text[1:]}."


def describe_before_after(data: BeforeAfter) -> str:
    """Return the figures as text for a console."""
    lines = [hidden_and_named(data)]
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


def _by_variant(error: ByVariant, fraction: float | None) -> str:
    listed = ", ".join(f"{LENGTH.text(e)} {v}" for v, e in error.items() if e is not None)
    return listed + ("" if fraction is None else f"; {FRACTION.text(fraction)} of the gap removed")
