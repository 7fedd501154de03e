"""A closed gap: the files that `make gap-demo` writes, the errors before and after, and their page.

::

    trials/                     dropstitch simulate --hide …      for the diagnosis
    sealed/                     the same on another motion              held out from all fits
    found/gap.json, plant.json  dropstitch gap
    check_twin_1dof.json        dropstitch fmu check … --json            of the rebuilt FMU
    fmpy_VARIANT_PAYLOAD.json   dropstitch fmu simulate … --json
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

from firmware_py.core.errors import InputError
from firmware_py.core.units import FRACTION, LENGTH, PAYLOAD, error_unit, signal_words
from hil.report.build_inputs import FmuCheckOutput, read_commands, read_output
from hil.sil.timing_document import TimingDocument, read_timing
from models.gap.report.gap_json import GapDocument, read_gap_document
from models.gap.report.gap_page import gap_lead, gap_sections
from models.gap.report.gap_words import effect_in_words
from models.plant.identification.evaluation import TIP
from models.plant.plant import Plant, read_plant
from models.shared.catalogue import effect_and_joint
from models.shared.pages import (
    NO_VALUE,
    Paragraph,
    Section,
    Table,
    folded_commands,
    render_page,
    value_text,
)
from models.trials.files import read_trials
from models.trials.origin import origin_notice, origins_of
from models.trials.trial import TrialSet

T = TypeVar("T")

MADE_BY: Final = "run 'make gap-demo'"
HEADINGS: Final = {
    "rigid": "rigid kinematics", "before": "before", "retrained": "new data, old plant",
    "after": "after", "without": "without the effect",
}  # fmt: skip
PART: Final = "motion"
"""Part of the robot's programme that is judged; training contains neither rest nor glide."""
SMALLEST_GAP: Final = 1.1
"""Ratio of the error before to the error without the effect up to which the gap is too small for
a fraction."""

ByVariant = dict[str, float | None]
Runs = dict[str, dict[float, T]]
"""Runs by variant, and by payload in kg."""


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
    fmus: Runs[FmuRunOutput]
    loops: Runs[TimingDocument]
    path_rms_m: ByVariant  # RMS path error of a plan; empty if no plan was run
    commands: list[str]  # Commands that wrote the files


class HiddenEffect(msgspec.Struct, frozen=True):
    """Effect that was hidden, and the diagnosis of it."""

    hidden: float  # Hidden strength
    estimate: float | None  # Estimated change of the strength
    error: float | None  # Standard error of the estimate
    text: str  # Result as text


class VariantErrors(msgspec.Struct, frozen=True):
    """Error of the tip by variant; None where a run lacks it."""

    heading: str
    error_m: ByVariant
    fraction_removed: float | None  # Fraction of the gap that was removed


class GapFigures(msgspec.Struct, frozen=True):
    """Figures of page and console, which `dropstitch report gap --json` prints too."""

    verdict: str  # Verdict of the diagnosis
    hidden: dict[str, HiddenEffect]
    also_named: list[str]  # Effects that were named without being hidden
    # By "fmu", "robot", "robot_heaviest", and "path" if a plan was run
    errors: dict[str, VariantErrors]


# --- files --------------------------------------------------------------------------------------


def read_gap(directory: Path, plant: Path) -> GapInputs:
    """Read the directory and the plant before the diagnosis."""
    for needed in ("found/gap.json", "check_twin_1dof.json"):
        if not (directory / needed).is_file():
            raise InputError(directory / needed, "is missing", MADE_BY)
    before = read_plant(plant)
    plans = {variant: directory / f"plan_{variant}" / "timing.json" for variant in HEADINGS}
    return GapInputs(
        diagnosis=read_gap_document(directory / "found" / "gap.json"),
        before=before,
        after=read_plant(directory / "found" / "plant.json"),
        trials=read_trials(directory / "trials", before.signals),
        sealed=read_trials(directory / "sealed", before.signals),
        check=read_output(directory / "check_twin_1dof.json", FmuCheckOutput),
        fmus=_runs(directory, "fmpy", ".json", lambda path: read_output(path, FmuRunOutput)),
        loops=_runs(directory, "sil", "/timing.json", read_timing),
        path_rms_m={
            variant: errors[-1].rms_m
            for variant, path in plans.items()
            if path.is_file() and (errors := read_timing(path).path_errors)
        },
        commands=read_commands(directory / "commands.log"),
    )


def _runs(directory: Path, kind: str, tail: str, read: Callable[[Path], T]) -> Runs[T]:
    """Read a file of each run; every payload needs `before` and `after`."""
    name = re.compile(rf"{kind}_({'|'.join(HEADINGS)})_(\d+(?:\.\d+)?){re.escape(tail)}")
    paths: Runs[Path] = {variant: {} for variant in HEADINGS}
    for path in directory.glob(f"{kind}_*{tail}"):
        if match := name.fullmatch(path.relative_to(directory).as_posix()):
            paths[match[1]][float(match[2])] = path
    for kg in sorted(paths["before"] | paths["after"]) or [0.0]:
        for variant in ("before", "after"):
            if kg not in paths[variant]:
                missing = directory / f"{kind}_{variant}_{kg:g}{tail}"
                raise InputError(missing, "is missing", MADE_BY)
    return {
        variant: {kg: read(path) for kg, path in sorted(of_variant.items())}
        for variant, of_variant in paths.items()
        if of_variant
    }


# --- figures ------------------------------------------------------------------------------------


def gap_figures(inputs: GapInputs, hidden: Mapping[str, float]) -> GapFigures:
    """Compare the diagnosis with what was hidden, and the errors of the tip before and after."""
    payloads = sorted(inputs.loops["before"])
    at_heaviest = f"at {PAYLOAD.significant(payloads[-1])}"
    errors = {
        "fmu": _tip_error("twin in FMPy, RMS", _fmu_rms_m(inputs.fmus)),
        "robot": _tip_error("robot, mean", _robot_mean_m(inputs.loops, payloads)),
        "robot_heaviest": _tip_error(
            f"robot {at_heaviest}, mean", _robot_mean_m(inputs.loops, payloads[-1:])
        ),
    }
    if inputs.path_rms_m:
        errors["path"] = _tip_error(f"off its path {at_heaviest}, RMS", inputs.path_rms_m)
    effects = {effect_and_joint(name)[0] for name in hidden}
    return GapFigures(
        verdict=inputs.diagnosis.verdict,
        hidden={effect: _hidden_effect(inputs, effect, s) for effect, s in hidden.items()},
        also_named=[row.effect for row in inputs.diagnosis.named if row.effect not in effects],
        errors=errors,
    )


def _tip_error(heading: str, error_m: ByVariant) -> VariantErrors:
    return VariantErrors(heading, error_m, fraction_removed(error_m))


def fraction_removed(error: Mapping[str, float | None]) -> float | None:
    """Return (before − after)/(before − without), the fraction of the gap that was removed.

    None if the gap is no more than a tenth of the error without the effect, or an error is missing.
    """
    before, after, without = (error.get(v) for v in ("before", "after", "without"))
    if before is None or after is None or without is None or before <= SMALLEST_GAP * without:
        return None
    return (before - after) / (before - without)


def _fmu_rms_m(fmus: Runs[FmuRunOutput]) -> ByVariant:
    """RMS distance between simulated and measured tip, from the RMS values of its coordinates."""
    return {
        variant: float(
            np.sqrt(len(TIP) * np.mean([run.rms[a] ** 2 for run in runs.values() for a in TIP]))
        )
        for variant, runs in fmus.items()
    }


def _robot_mean_m(loops: Runs[TimingDocument], payloads: Sequence[float]) -> ByVariant:
    """Mean distance between predicted and true tip; None if a run lacks the judged part."""
    mean_m: ByVariant = {}
    for variant, runs in loops.items():
        parts = [runs[kg].prediction_error.parts.get(PART) if kg in runs else None
                 for kg in payloads]  # fmt: skip
        distances_m = [part.mean_euclidean_distance_m for part in parts if part is not None]
        measured = [distance for distance in distances_m if distance is not None]
        mean_m[variant] = float(np.mean(measured)) if len(measured) == len(payloads) else None
    return mean_m


def _hidden_effect(inputs: GapInputs, hidden: str, strength: float) -> HiddenEffect:
    effect, joint = effect_and_joint(hidden)
    words = effect_in_words(hidden)
    named = {row.effect: row for row in inputs.diagnosis.named}
    if row := named.get(effect):
        strengths = inputs.after.strengths(effect, inputs.trials[0].meta.dof)
        # Without a joint, all joints have the same strength.
        q = row.parameters[strengths[(row.joint or joint or 1) - 1]]
        change, unit = q.value - q.before, error_unit(q.unit)
        error = "" if q.error is None else f" ± {unit.factor * q.error:.2g}"
        estimate = f"{unit.factor * change:.3g}{error} {unit.name}".strip()
        text = f"{words}: {unit.significant(strength)} hidden, {estimate} estimated"
        return HiddenEffect(strength, change, q.error, text)
    text = f"{words} was hidden and not named"
    for name, row in named.items():
        if effect in {effect_and_joint(e)[0] for group in row.look_alikes for e in group.effects}:
            text = f"{words} was hidden; its look-alike {name.replace('_', ' ')} was named"
    return HiddenEffect(strength, None, None, text)


# --- page and console ---------------------------------------------------------------------------


def hidden_and_named(figures: GapFigures) -> str:
    """Which of the hidden effects were named, and what was named beside them."""
    results = [row.text for row in figures.hidden.values()] or ["no effect was hidden"]
    results += [f"{e.replace('_', ' ')} was named without being hidden" for e in figures.also_named]
    text = "; ".join(results)
    return f"{text[0].upper()}{text[1:]}."


def error_rows(figures: GapFigures) -> list[list[str]]:
    """Errors of the tip as a table: a heading, a row for each variant, and what was removed."""
    errors = figures.errors.values()
    rows = [["error of the tip", *(error.heading for error in errors)]]
    for variant, heading in HEADINGS.items():
        shown = [value_text(error.error_m.get(variant), LENGTH) for error in errors]
        if any(text != NO_VALUE for text in shown):
            rows.append([heading, *shown])
    removed = [value_text(error.fraction_removed, FRACTION) for error in errors]
    return [*rows, ["gap removed", *removed]]


def describe_gap(figures: GapFigures) -> str:
    """Return the figures as text for a console."""
    rows = error_rows(figures)
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [
        "  ".join([name.ljust(widths[0]), *map(str.rjust, cells, widths[1:])])
        for name, *cells in rows
    ]
    return "\n".join([hidden_and_named(figures), *lines])


def closed_gap_page(inputs: GapInputs, figures: GapFigures) -> str:
    """Return the page as HTML."""
    *diagnosis, not_named = gap_sections(inputs.diagnosis)
    sections = [
        Section("glance", "Results", [_results(figures)]),
        *diagnosis,
        _fmu(inputs),
        _robot(inputs.loops),
        not_named,
        Section("made", "Commands", [folded_commands(inputs.commands)]),
    ]
    lead = [
        origin_notice(origins_of([*inputs.trials, *inputs.sealed])),
        Paragraph(hidden_and_named(figures)),
        *gap_lead(inputs.diagnosis, inputs.before, inputs.after, inputs.trials),
    ]
    return render_page("A hidden effect, from trial to robot", lead, sections)


def _results(figures: GapFigures) -> Table:
    header, *rows = error_rows(figures)
    note = (
        "The twin runs on a motion that no value was fitted to. The robot predicts its tip. “New "
        "data, old plant” is a bundle trained on the same new trials as the one after, with the "
        "observer of the old plant: the effect of new measurements alone. "
    )
    if "path" in figures.errors:
        note += (
            "The path is a line, planned with the plant before and after the diagnosis or by rigid "
            "kinematics; the payload is known, and the estimated tip is fed back. "
        )
    note += (
        "The hidden and the estimated strength may differ by more than the standard error, because "
        "the equations of the rig differ from those of the plant."
    )
    return Table("", header, rows, note)


def _fmu(inputs: GapInputs) -> Section:
    """Section on the twin FMUs in FMPy on the sealed trials."""
    runs = inputs.fmus
    first = next(iter(runs["before"].values()))
    rows = []
    for signal in first.rms:
        if not signal.startswith("predicted_"):
            unit = error_unit(first.units[signal])
            rms = [
                np.sqrt(np.mean([run.rms[signal] ** 2 for run in of_variant.values()]))
                for of_variant in runs.values()
            ]
            rows.append([signal_words(signal), *map(unit.significant, rms)])
    table = Table(
        "", ["RMS error", *(HEADINGS[v] for v in runs)], rows,
        f"Twin FMUs in FMPy, driven by the goals of {len(inputs.sealed)} trials of another motion, "
        "which neither identification nor diagnosis used. In the last column the trials are "
        "without the effect: the error of the old plant there is about the smallest possible. The "
        f"rebuilt FMU {'passed' if inputs.check.passed else 'failed'} fmu check.",
    )  # fmt: skip
    return Section("fmu", "Rebuilt FMU in FMPy", [table])


def _robot(loops: Runs[TimingDocument]) -> Section:
    """Section on the robot's prediction of the tip with each bundle."""
    rows = [
        [
            PAYLOAD.significant(kg),
            *(_judged(runs.get(kg)) for runs in loops.values()),
        ]
        for kg in sorted(loops["before"])
    ]
    table = Table(
        "Mean distance between predicted and true tip in motion, and coverage of the 95\u00a0% "
        "interval",
        ["payload", *(HEADINGS[v] for v in loops)], rows,
        "The robot's loop and emulated servos on the virtual line. The rig with the hidden effect "
        "is the physics, with newly drawn variation. The robot measures angle and current and "
        "predicts its tip; the rig knows the true tip.",
    )  # fmt: skip
    return Section("robot", "Prediction of the robot", [table])


def _judged(timing: TimingDocument | None) -> str:
    part = timing.prediction_error.parts.get(PART) if timing else None
    if part is None:
        return NO_VALUE
    distance = value_text(part.mean_euclidean_distance_m, LENGTH)
    return f"{distance}, {value_text(part.interval_coverage, FRACTION)}"
