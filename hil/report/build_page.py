"""Report of a build: the arm, its errors and timing, the plant, and the study if there is one."""

from __future__ import annotations

import importlib.metadata
import platform
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Final

import numpy as np

from firmware_py.core.units import LENGTH
from hil.faults.faults_document import FaultsDocument
from hil.report.build_inputs import BuildInputs
from hil.report.fault_section import campaign_parts
from hil.report.loop_section import arm_parts, error_parts, timing_parts
from hil.report.plant_section import fmu_parts, plant_parts
from hil.report.study_section import study_origins, study_parts
from hil.verdict import Verdict
from models.shared.pages import (
    Cell,
    Facts,
    Notice,
    Paragraph,
    Part,
    Section,
    Table,
    folded_commands,
    missing_inputs,
    render_page,
)
from models.trials.origin import (
    KIND_WORDS,
    TrialOrigin,
    kind_of_origins,
    merged_origins,
    origin_notice,
)

LIBRARIES: Final = ("numpy", "scikit-learn", "onnxruntime", "casadi", "mujoco", "fmpy")
EMULATED: Final = Notice(
    "simulated", "Emulated",
    "The loop is the robot's; line and servos are emulated. No robot was run.",
)  # fmt: skip
"""Notice of pages that show runs of the loop."""


def report_page(
    inputs: BuildInputs, progress: Callable[[str, int], None] = lambda title, further: None
) -> str:
    """Return the report as HTML.

    `progress` gets the title of each section that is drawn, and how many follow.
    """
    planned, sections = _sections(inputs), []
    for k, (name, title, draw) in enumerate(planned, start=1):
        if parts := draw():
            sections.append(Section(name, title, parts))
        progress(title, len(planned) - k)
    head: list[Part] = [*report_notices(inputs)]
    if lead := _lead(inputs):
        head.append(Paragraph(lead, "lead"))
    return render_page("Report of a build", head, sections, datetime.now(UTC))


def _sections(inputs: BuildInputs) -> list[tuple[str, str, Callable[[], list[Part]]]]:
    """Id and title of each section, and what draws its parts; one without parts is left out."""
    loops, faults = inputs.loops, inputs.faults
    return [
        ("arm", "The arm", lambda: arm_parts(loops)),
        ("errors", "Errors of the tip", lambda: error_parts(loops)),
        ("timing", "Timing", lambda: timing_parts(loops)),
        ("plant", "Plant", lambda: plant_parts(inputs.plant, inputs.evaluations)),
        ("fmus", "FMUs", lambda: fmu_parts(inputs.checks)),
        ("faults", "Fault campaign", lambda: campaign_parts(faults) if faults else []),
        ("study", "Study", lambda: study_parts(inputs)),
        ("made", "Origin, commands and versions", lambda: _made(inputs)),
    ]


def _lead(inputs: BuildInputs) -> str:
    """The result in a sentence: how well the robot predicts its tip, and whether it is in time."""
    sentences = []
    errors_m = [
        error_m
        for loop in inputs.loops
        if (error_m := loop.timing.prediction_error.mean_euclidean_distance_m) is not None
    ]
    rigid_m = [
        float(np.nanmean(off)) for loop in inputs.loops if (off := loop.rigid_off_m()) is not None
    ]
    if errors_m and rigid_m:
        sentences.append(
            "In software the robot predicts its tip within "
            f"{LENGTH.text(max(errors_m))} on average, where rigid kinematics is up to "
            f"{LENGTH.text(max(rigid_m), 0)} off."
        )
    timed = [loop.timing for loop in inputs.loops if loop.in_real_time]
    if timed:
        own_misses, slots = sum(t.own_misses for t in timed), sum(t.slots for t in timed)
        sentences.append(f"The loop itself missed {own_misses or 'none'} of {slots} deadlines.")
        if by_host := sum(t.misses for t in timed) - own_misses:
            sentences.append(f"The host took {by_host} more.")
        if undecided := sum(t.verdict is Verdict.INCONCLUSIVE for t in timed):
            runs = f"{undecided} of {len(timed)} runs" if len(timed) > 1 else "the run"
            sentences.append(f"The timing of {runs} is inconclusive.")
    return " ".join(sentences)


def fault_page(document: FaultsDocument) -> str:
    """Return the page of a fault campaign as HTML."""
    lead = Paragraph(
        "Faults of bus, servo, host and process, injected by name and seed while the arm moves: "
        "the required reaction beside the one observed.",
        "lead",
    )
    sections = [Section("faults", "Campaign", campaign_parts(document))]
    return render_page("Fault campaign", [EMULATED, lead], sections, datetime.now(UTC))


# --- origins, commands and versions -------------------------------------------------------------


def report_notices(inputs: BuildInputs) -> list[Notice]:
    """Return the notices at the head of a report, on its trials and on its runs of the loop."""
    of_trials = _trial_origins(inputs).values()
    origins = merged_origins(origin for origins in of_trials for origin in origins)
    notices = [origin_notice(origins)] if origins else []
    return [*notices, EMULATED] if inputs.loops or inputs.faults else notices


def origin_table(inputs: BuildInputs) -> Table | None:
    """Return a table of the origin of each part's data; None if there is none."""
    rows: list[list[Cell]] = [
        [what, KIND_WORDS[kind_of_origins(origins)], ", ".join(o.counted for o in origins)]
        for what, origins in _trial_origins(inputs).items()
    ]
    for loop in inputs.loops:
        behind = loop.timing.environment.behind_the_servos
        words = f"emulated servos, the {behind} behind them"
        rows.append([f"Control loop, {loop.name}", KIND_WORDS["simulated"], words])
    return Table("Where the figures come from", ["", "", "trials"], rows) if rows else None


def _trial_origins(inputs: BuildInputs) -> dict[str, tuple[TrialOrigin, ...]]:
    """Origins by the part of the report that shows the trials."""
    origins: dict[str, tuple[TrialOrigin, ...]] = {}
    if inputs.plant and inputs.plant.provenance.fitted_trials:
        origins["Plant, fitted to"] = inputs.plant.provenance.origins
    for title, evaluation in inputs.evaluations.items():
        origins[f"Plant, compared with {title}"] = evaluation.origins
    return origins | {f"Study, {name}": study_origins(s) for name, s in inputs.studies.items()}


def _made(inputs: BuildInputs) -> list[Part]:
    parts: list[Part] = []
    if origins := origin_table(inputs):
        parts.append(origins)
    if inputs.left_out:
        parts.append(Paragraph("Not shown: " + "; ".join(inputs.left_out) + ".", "missing"))
    lacking = {
        "runs of the loop": ("dropstitch sil", inputs.loops),
        "plant": ("dropstitch identify", inputs.plant),
        "checks of an FMU": ("dropstitch fmu check … --json", inputs.checks),
        "fault campaign": ("make faults", inputs.faults),
        "study": ("make study", inputs.studies),
    }
    if missing := {what: made_by for what, (made_by, content) in lacking.items() if not content}:
        parts.append(missing_inputs(missing))
    if inputs.commands:
        parts.append(folded_commands(inputs.commands))
    versions = [("python", platform.python_version()), ("machine", platform.platform())]
    versions += [(name, importlib.metadata.version(name)) for name in LIBRARIES]
    return [*parts, Facts(versions)]
