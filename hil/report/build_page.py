"""Report of a build: a section for each kind of input, or the command that makes a missing one."""

from __future__ import annotations

import importlib.metadata
import platform
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from functools import partial
from typing import Final

from firmware_py.core.units import (
    CPU_TIME,
    FILE_SIZE,
    FRACTION,
    LENGTH,
    TICK_TIME,
    error_unit,
    signal_words,
    symbol_of,
)
from firmware_py.system.targets import (
    DI_GAIN_DEGREE,
    DI_GAIN_FRACTION,
    FMU_PARITY,
    PLANT_TIP_RMS_M,
)
from hil.faults.faults_document import FaultsDocument
from hil.report.build_inputs import BuildInputs, FmuCheckOutput, motion_words
from hil.report.fault_section import campaign_parts
from hil.report.loop_section import loop_parts, loop_title
from hil.report.study_figures import (
    candidate_table,
    di_estimates,
    di_estimator_table,
    error_figures,
    motion_figures,
    predictor_table,
    predictors_by_payload,
)
from models.plant.document import Evaluation, SignalError, TipError
from models.plant.plant import Plant
from models.shared.pages import (
    NO_VALUE,
    Cell,
    ClaimCard,
    ClaimCards,
    CommandList,
    Facts,
    Notice,
    Paragraph,
    Part,
    Section,
    Table,
    TableCell,
    missing_inputs,
    render_page,
)
from models.study.document import StudyDocument
from models.trials.origin import (
    KIND_WORDS,
    TrialOrigin,
    kind_of_origins,
    merged_origins,
    origin_notice,
)

ByDof = Mapping[int | None, float | None]
"""Value by number of joints."""

DOFS: Final = (1, 2)
DEFAULT_RIG: Final = ("rig", "default")
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
    lead = Paragraph(
        "Results for an inflatable drop-stitch link on one or two servos: predictors without "
        "motion capture, the identified plant and its FMUs, and the control loop.",
        "lead",
    )
    head: list[Part] = [*report_notices(inputs), lead]
    return render_page("Report of a build", head, sections, datetime.now(UTC))


def _sections(inputs: BuildInputs) -> list[tuple[str, str, Callable[[], list[Part]]]]:
    """Id and title of each section, and what draws its parts; one without parts is left out."""
    loops: list[tuple[str, str, Callable[[], list[Part]]]] = [
        (loop.name, loop_title(loop), partial(loop_parts, loop)) for loop in inputs.loops
    ]
    return [
        ("glance", "Results and targets", lambda: [results_table(inputs)]),
        ("findings", "Findings of the paper", lambda: _findings(inputs.every_study)),
        ("study", "Study", lambda: _study(inputs)),
        ("estimators", "Predictors and estimators", lambda: _estimators(inputs)),
        ("plant", "Plant", lambda: _plant(inputs)),
        ("fmus", "FMUs", lambda: _fmus(inputs.checks)),
        *(loops or [("loop", "Control loop", lambda: [missing_inputs("dropstitch sil")])]),
        ("faults", "Fault campaign", lambda: _faults(inputs.faults)),
        ("made", "Origin, commands and versions", lambda: _made(inputs)),
    ]


def _faults(document: FaultsDocument | None) -> list[Part]:
    return campaign_parts(document) if document else [missing_inputs("make faults")]


def fault_page(document: FaultsDocument) -> str:
    """Return the page of a fault campaign as HTML."""
    lead = Paragraph(
        "Faults of bus, servo, host and process, injected by name and seed while the arm moves: "
        "the required reaction beside the one observed.",
        "lead",
    )
    sections = [Section("faults", "Campaign", campaign_parts(document))]
    return render_page("Fault campaign", [EMULATED, lead], sections, datetime.now(UTC))


# --- results ------------------------------------------------------------------------------------


def results_table(inputs: BuildInputs) -> Table:
    """Return the results with their targets; a missing measurement is not judged."""
    rows = [_tip_row(inputs.evaluations.get(t), t) for t in inputs.evaluations or ("trials",)]
    for test, least in DI_GAIN_FRACTION.items():
        name = (
            f"Fraction of true DI's gain recovered by estimated DI, degree {DI_GAIN_DEGREE}, "
            f"{motion_words(test)}"
        )
        gains: ByDof = {dof: _gain(study, test) for dof, study in inputs.studies.items()}
        target = f"≥\u00a0{FRACTION.text(least)}"
        rows.append(_row(name, target, gains, _both(least), FRACTION.text, at_least=True))
    parity: ByDof = {
        dof: max(check.parity.values(), default=None)
        for dof in DOFS
        if (check := inputs.checks.get(f"twin_{dof}dof"))
    }
    # A run on the virtual line measures no cost.
    timing = {loop.dof: loop.timing for loop in reversed(inputs.loops) if loop.in_real_time}
    rows += [
        _row("Largest difference of the twin FMU from the Python plant, SI units",
             f"≤\u00a0{_power(FMU_PARITY, 0)}", parity, _both(FMU_PARITY), lambda v: _power(v, 0)),
        _row("Own cost of a tick, p99 (depends on the machine, not judged)", NO_VALUE,
             {dof: run.own_cost.p99_ns for dof, run in timing.items()}, {},
             lambda v: TICK_TIME.text(v, 2)),
        _row("Deadlines missed by the loop itself", "0",
             {dof: run.own_misses for dof, run in timing.items()}, _both(0), lambda v: f"{v:.0f}"),
    ]  # fmt: skip
    return Table("", ["", "target", "1DOF", "2DOF"], rows)


def _both(limit: float) -> ByDof:
    return dict.fromkeys(DOFS, limit)


def _row(
    name: str,
    target: str,
    values: ByDof,
    limits: ByDof,
    text: Callable[[float], str],
    at_least: bool = False,
) -> list[Cell]:
    """Row of the results: a value for each dof, and whether it is within the limit."""
    row: list[Cell] = [name, target]
    for dof in DOFS:
        value, limit = values.get(dof), limits.get(dof)
        if value is None:
            row.append(NO_VALUE)
        elif limit is None:
            row.append(text(value))
        else:
            row.append(TableCell(text(value), value >= limit if at_least else value <= limit))
    return row


def _tip_row(evaluation: Evaluation | None, title: str) -> list[Cell]:
    """Tip error of the plant; its targets exist only for trials of the default rig."""
    values_m: ByDof = {}
    limits_m: ByDof = {}
    if evaluation is not None:
        values_m = {int(dof): part.tip_rms_m for dof, part in evaluation.dof.items()}
        if {(origin.source, origin.rig) for origin in evaluation.origins} == {DEFAULT_RIG}:
            limits_m = {dof: limit for dof, limit in PLANT_TIP_RMS_M.get(title, {}).items()}
    most = "\u00a0/\u00a0".join(LENGTH.number(limit) for limit in limits_m.values() if limit)
    target = f"≤\u00a0{most}\u00a0{LENGTH.name}" if most else NO_VALUE
    name = f"Tip error (RMS) of the identified plant, {title}"
    return _row(name, target, values_m, limits_m, LENGTH.text)


def _gain(study: StudyDocument, test: str) -> float | None:
    if test not in study.estimators:
        return None
    return study.estimators[test]["observer"].benefit_recovered[DI_GAIN_DEGREE]


def _power(value: float, decimals: int) -> str:
    """Format a small number like "1e-9", without zeros in the exponent."""
    if value == 0.0:
        return "0"
    mantissa, exponent = f"{value:.{decimals}e}".split("e")
    return f"{mantissa}e{int(exponent)}"


# --- study and predictors -----------------------------------------------------------------------


def _findings(studies: Mapping[str, StudyDocument]) -> list[Part]:
    """Cards with the findings of all studies, equal texts once; a link of one's own has none."""
    if not studies:
        return [missing_inputs("dropstitch train --study")]
    badges = study_badges(studies)
    claims: dict[str, dict[tuple[bool | None, str], list[str]]] = {}
    depends_on: dict[str, list[str]] = {}
    for name, study in studies.items():
        for finding in study.findings:
            verdict = (finding.holds, finding.text.replace("trial_2", "trial 2"))
            claims.setdefault(finding.claim, {}).setdefault(verdict, []).append(badges[name])
            depends_on.setdefault(finding.claim, []).append(finding.depends_on)
    cards = [
        ClaimCard(
            claim,
            [(names, holds, text) for (holds, text), names in verdicts.items()],
            list(dict.fromkeys(depends_on[claim])),
        )
        for claim, verdicts in claims.items()
    ]
    intro = (
        "No parameter was tuned to reproduce the paper. A finding comes out of these trials or "
        "not, and each depends on a property that can be measured on the real link."
    )
    return [Paragraph(intro), ClaimCards(cards)] if cards else []


def _study(inputs: BuildInputs) -> list[Part]:
    if not inputs.studies:
        return [missing_inputs("dropstitch train --study")]
    intro = (
        "Figures 7 to 15 of the paper, drawn from the trials of this build. The paper does not "
        "state the phase by which joint 2 leads joint 1: at 0° both joints move together, at 90° "
        "the tip follows a loop. Each phase has a study of its own; the 2DOF predictor of the "
        "robot is trained on all phases."
    )
    return [
        Paragraph(intro), *motion_figures(inputs.motions), *error_figures(inputs.every_study),
    ]  # fmt: skip


def _estimators(inputs: BuildInputs) -> list[Part]:
    candidates = [candidate_table(inputs.predictors)] if inputs.predictors else []
    if not inputs.studies:
        return [*candidates, missing_inputs("dropstitch train --study")]
    intro = (
        "On the robot DI is not measured. The plant observer estimates it from angle and current. "
        "It is compared with a lagged regressor and with no DI, on trial 2 and on a motion that "
        "neither training nor identification used."
    )
    return [
        *candidates, Paragraph(intro), predictors_by_payload(inputs.studies),
        di_estimates(inputs.studies), predictor_table(inputs.every_study),
        di_estimator_table(inputs.studies),
    ]  # fmt: skip


# --- plant and FMUs -----------------------------------------------------------------------------


def _plant(inputs: BuildInputs) -> list[Part]:
    parts: list[Part] = [missing_inputs("dropstitch evaluate")]
    if inputs.evaluations:
        parts = [_evaluation_table(inputs.evaluations)]
    if inputs.plant and (fitted := _parameter_table(inputs.plant)):
        parts.append(fitted)
    return parts


def _evaluation_table(evaluations: Mapping[str, Evaluation]) -> Table:
    """Errors of the identified plant by signal, with rigid kinematics as baseline."""
    columns = {
        f"{title}, {dof}DOF": part
        for title, evaluation in evaluations.items()
        for dof, part in evaluation.dof.items()
    }
    parts = columns.values()
    rows = [
        [signal_words(name), *(_signal_error(part.signals.get(name)) for part in parts)]
        for name in sorted({name for part in parts for name in part.signals})
    ]
    rows.append(["tip, all axes", *map(_beside_rigid, parts)])
    rows += [
        [f"tip at {kg} kg", *(_beside_rigid(part.payloads.get(kg)) for part in parts)]
        for kg in dict.fromkeys(kg for part in parts for kg in part.payloads)
    ]
    return Table(
        "Identified plant on trials that it was not fitted to",
        ["", *columns],
        rows,
        "Signals: RMS error, in brackets the mean absolute error. Tip: RMS error, in brackets that "
        "of rigid kinematics, which is a link that does not bend at the measured angles.",
    )


def _signal_error(error: SignalError | None) -> str:
    if error is None:
        return NO_VALUE
    unit = error_unit(error.unit)
    return f"{unit.significant(error.rms)} ({unit.factor * error.mae:.3g})"


def _beside_rigid(error: TipError | None) -> str:
    if error is None or error.tip_rms_m is None or error.rigid_tip_rms_m is None:
        return NO_VALUE
    return f"{LENGTH.text(error.tip_rms_m)} ({LENGTH.number(error.rigid_tip_rms_m)})"


def _parameter_table(plant: Plant) -> Table | None:
    """Identified parameters with standard errors; None if nothing was fitted."""
    rows = []
    for name in plant.provenance.fitted_parameters:
        if q := plant.parameters.get(name):
            value = f"{q.value:.4g}".replace("-", "−")
            error = NO_VALUE if q.error is None else f"{q.error:.2g}"
            rows.append([name, value, error, symbol_of(q.unit)])
    header = ["", "value", "standard error", "unit"]
    return Table("Identified parameters", header, rows) if rows else None


def _fmus(checks: Mapping[str, FmuCheckOutput]) -> list[Part]:
    if not checks:
        command = "dropstitch fmu check build/twin_1dof.fmu --json > build/check_twin_1dof.json"
        return [missing_inputs(command)]
    listed = [
        f"{name}: FMI {check.fmi}, {FILE_SIZE.text(check.bytes)}, "
        f"{'all checks passed' if check.passed else 'a check failed'}"
        + "".join(
            f", {us:.0f}\u00a0{CPU_TIME.name} per step {how.replace('_', ' ')}"
            for how, us in check.step_us.items()
        )
        for name, check in checks.items()
    ]
    kinds = dict.fromkeys(c.name for check in checks.values() for c in check.checks)
    rows = [[kind, *(_check_cell(check, kind) for check in checks.values())] for kind in kinds]
    return [Paragraph("; ".join(listed) + "."), Table("Checks", ["", *checks], rows)]


def _check_cell(check: FmuCheckOutput, kind: str) -> Cell:
    results = [c for c in check.checks if c.name == kind]
    details = "; ".join(dict.fromkeys(c.detail for c in results))
    return TableCell(details, all(c.passed for c in results)) if results else NO_VALUE


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


def study_badges(studies: Mapping[str, StudyDocument]) -> dict[str, str]:
    """Return a label of each study with the kind of its trials, like "1DOF, simulated"."""
    kinds = {name: kind_of_origins(_study_origins(study)) for name, study in studies.items()}
    return {name: f"{name}, {KIND_WORDS[kind].lower()}" for name, kind in kinds.items()}


def _study_origins(study: StudyDocument) -> tuple[TrialOrigin, ...]:
    parts = (study.training, *study.tests.values())
    return merged_origins(origin for part in parts for origin in part.origins)


def _trial_origins(inputs: BuildInputs) -> dict[str, tuple[TrialOrigin, ...]]:
    """Origins by the part of the report that shows the trials."""
    origins = {f"Study, {name}": _study_origins(s) for name, s in inputs.every_study.items()}
    if inputs.plant and inputs.plant.provenance.fitted_trials:
        origins["Plant, fitted to"] = inputs.plant.provenance.origins
    for title, evaluation in inputs.evaluations.items():
        origins[f"Plant, compared with {title}"] = evaluation.origins
    return origins


def _made(inputs: BuildInputs) -> list[Part]:
    parts: list[Part] = []
    if origins := origin_table(inputs):
        parts.append(origins)
    if inputs.left_out:
        parts.append(Paragraph("Not shown: " + "; ".join(inputs.left_out) + ".", "missing"))
    parts.append(CommandList(inputs.commands) if inputs.commands else missing_inputs("make demo"))
    versions = [("python", platform.python_version()), ("machine", platform.platform())]
    versions += [(name, importlib.metadata.version(name)) for name in LIBRARIES]
    versions += [
        (f"training data {dof}DOF", manifest.training_data_sha256[:16])
        for dof, manifest in inputs.manifests.items()
    ]
    return [*parts, Facts(versions)]
