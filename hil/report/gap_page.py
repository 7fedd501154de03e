"""Page of a gap before and after it was closed: the diagnosis, the rebuilt FMU and the robot."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.units import FRACTION, LENGTH, PAYLOAD, error_unit, signal_words
from hil.report.build_inputs import LoopRun
from hil.report.gap_results import (
    BeforeAfter,
    GapInputs,
    hidden_and_named,
    judged_part,
    same_in_python,
)
from models.gap.report.gap_page import gap_lead, gap_sections
from models.shared.pages import (
    NO_VALUE,
    Paragraph,
    Section,
    Table,
    folded_commands,
    render_page,
    value_text,
)
from models.trials.origin import origin_notice, origins_of

Array = NDArray[np.float64]

HEADINGS: Final = {
    "before": "before", "retrained": "new data, old plant", "after": "after",
    "without": "without the effect", "rigid": "rigid kinematics",
}  # fmt: skip


def before_after_page(inputs: GapInputs, data: BeforeAfter) -> str:
    """Return the page as HTML."""
    *diagnosis, not_named = gap_sections(inputs.diagnosis)
    sections = [
        Section("glance", "Results", [_results(data)]),
        *diagnosis,
        _fmu(inputs, data),
        _robot(inputs),
        *_plans(data),
        not_named,
        Section("made", "Commands", [folded_commands(inputs.commands)]),
    ]
    lead = [
        origin_notice(origins_of([*inputs.trials, *inputs.sealed])),
        Paragraph(hidden_and_named(data)),
        *gap_lead(inputs.diagnosis, inputs.before, inputs.after, inputs.trials),
    ]
    return render_page("A hidden effect, from trial to robot", lead, sections)


def _results(data: BeforeAfter) -> Table:
    variants = ("before", "after", "without")
    fmu, robot, heaviest = data.fmu, data.robot, data.robot_heaviest
    distances = {
        "Rebuilt twin in FMPy, tip error (RMS) on a motion that no value was fitted to":
            (fmu.tip_rms_m, fmu.fraction_removed),
        "Robot in the loop, mean distance between predicted and true tip":
            (robot.tip_mean_m, robot.fraction_removed),
        f"The same at {PAYLOAD.significant(data.heaviest_kg)}":
            (heaviest.tip_mean_m, heaviest.fraction_removed),
    }  # fmt: skip
    rows = [
        [
            name,
            *(value_text(error.get(v), LENGTH) for v in variants),
            value_text(fraction, FRACTION),
        ]
        for name, (error, fraction) in distances.items()
    ]
    coverage = [value_text(heaviest.interval_coverage.get(v), FRACTION) for v in variants]
    rows.append(["Coverage of the 95\u00a0% interval at this payload", *coverage, ""])
    return Table(
        "", ["", *(HEADINGS[v] for v in variants), "gap removed"], rows,
        "The hidden and the estimated strength may differ by more than the standard error, because "
        "the equations of the rig differ from those of the plant.",
    )  # fmt: skip


def _fmu(inputs: GapInputs, data: BeforeAfter) -> Section:
    """Section on the twin FMUs in FMPy on the sealed trials."""
    runs = inputs.fmus
    heaviest_kg = max(runs["before"])
    units = runs["before"][heaviest_kg].units
    rows = []
    for signal in runs["before"][heaviest_kg].rms:
        if not signal.startswith("predicted_"):
            rms = [
                np.sqrt(np.mean([run.rms[signal] ** 2 for run in of_variant.values()]))
                for of_variant in runs.values()
            ]
            shown = map(error_unit(units[signal]).significant, rms)
            rows.append([signal_words(signal), *shown])
    table = Table(
        "", ["RMS error", *(HEADINGS[v] for v in runs)], rows,
        f"Twin FMUs in FMPy, driven by the goals of {len(inputs.sealed)} trials of another motion, "
        "which neither identification nor diagnosis used. The results are "
        f"{same_in_python(data.fmu.worst_difference)}. In the last column the trials are without "
        "the effect: the error of the old plant there is about the smallest possible. The rebuilt "
        f"FMU {'passed' if data.fmu.passed else 'failed'} fmu check.",
    )  # fmt: skip
    return Section("fmu", "Rebuilt FMU in FMPy", [table])


def _robot(inputs: GapInputs) -> Section:
    """Section on the robot's prediction of the tip with each bundle."""
    loops = inputs.loops
    payloads = sorted(loops["before"])
    rows = [
        [PAYLOAD.significant(kg), *(_judged(of_variant.get(kg)) for of_variant in loops.values())]
        for kg in payloads
    ]
    table = Table(
        "Mean distance between predicted and true tip in motion, and coverage of the 95\u00a0% "
        "interval",
        ["payload", *(HEADINGS[v] for v in loops)], rows,
        "The robot's loop and emulated servos on the virtual line. The rig with the hidden effect "
        "is the physics, with newly drawn variation. The robot measures angle and current and "
        "predicts its tip; the rig knows the true tip. “New data, old plant” is a bundle trained "
        "on the same new trials as the one after, with the observer of the old plant: the effect "
        "of new measurements alone.",
    )  # fmt: skip
    return Section("robot", "Prediction of the robot", [table])


def _plans(data: BeforeAfter) -> list[Section]:
    """Section on the path error of plans with the old and with the improved plant."""
    if not (errors := data.path_rms_m):
        return []
    rigid = errors.get("rigid")
    rows = [
        [HEADINGS[v], value_text(rms, LENGTH), f"{rigid / rms:.1f}" if rigid and rms else NO_VALUE]
        for v, rms in errors.items()
    ]
    table = Table(
        f"Distance of the tip from its path at {PAYLOAD.significant(data.heaviest_kg)}, RMS",
        ["goals of the plan", "distance", "rigid over this"], rows,
        "A sinusoid of the tip, planned with the plant before and after the diagnosis, run by the "
        "robot's loop with the bundle of the same plant; the rig has the hidden effect. The "
        "payload is known, and the estimated tip is fed back. The last row is the plan before, on "
        "a rig without the effect.",
    )  # fmt: skip
    return [Section("plans", "The tip on its path", [table])]


def _judged(loop: LoopRun | None) -> str:
    part = judged_part(loop) if loop else None
    if part is None:
        return NO_VALUE
    distance = value_text(part.mean_euclidean_distance_m, LENGTH)
    return f"{distance}, {value_text(part.interval_coverage, FRACTION)}"
