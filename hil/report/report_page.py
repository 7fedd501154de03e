"""Report page: a section for each kind of input, or the command that makes a missing input."""

from __future__ import annotations

import importlib.metadata
import platform
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any, Final

import msgspec

from firmware_py.core.units import ANGLE, CPU_TIME, FILE_SIZE, PAYLOAD, TICK_TIME
from firmware_py.inference.manifest import Manifest
from hil.faults.faults_document import FaultsDocument
from hil.report.build_inputs import BuildInputs, LoopRun
from hil.report.fault_tables import campaign_facts, campaign_sentences, campaign_tables
from hil.report.loop_figures import duration_table, loop_figures
from hil.report.report_origins import EMULATED, origin_table, report_notices, study_badges
from hil.report.report_tables import (
    di_estimator_table,
    evaluation_table,
    fmu_tables,
    parameter_table,
    prediction_table,
    predictor_table,
    results_table,
    verdict_sentence,
)
from hil.report.study.candidate_table import candidate_table
from hil.report.study.error_figures import error_figures
from hil.report.study.estimator_figures import di_estimates, predictors_by_payload
from hil.report.study.motion_figures import motion_figures
from hil.sil.timing_document import SilEnvironment
from models.shared.pages import (
    ClaimCard,
    ClaimCards,
    CommandList,
    Facts,
    Paragraph,
    Part,
    Section,
    missing_inputs,
    render_page,
)
from models.study.document import StudyDocument

LIBRARIES: Final = ("numpy", "scikit-learn", "onnxruntime", "casadi", "mujoco", "fmpy")


SECTIONS: Final = 8
"""Sections of the report beside those of the loops."""


def report_page(inputs: BuildInputs, report: Callable[[str], None] = lambda title: None) -> str:
    """Return the report as HTML; `report` gets the title of each section that is drawn."""

    def section(name: str, title: str, parts: list[Part]) -> Section:
        report(title)
        return Section(name, title, parts)

    lead = Paragraph(
        "Results for an inflatable drop-stitch link on one or two servos: the published study, "
        "predictors without motion capture, the identified plant and its FMUs, and the control "
        "loop with its 17\u00a0ms period.",
        "lead",
    )
    sections = [
        section("glance", "Results and targets", [results_table(inputs)]),
        section("findings", "Findings of the paper", _findings(inputs.every_study)),
        section("study", "Study", _study(inputs)),
        section("estimators", "Predictors and estimators", _estimators(inputs)),
        section("plant", "Plant", _plant(inputs)),
        section("fmus", "FMUs", _fmus(inputs)),
        *_loops(inputs, section),
        section("faults", "Fault campaign",
                _campaign(inputs.faults) if inputs.faults else [missing_inputs("make faults")]),
        section("made", "Origin, commands and versions", _made(inputs)),
    ]  # fmt: skip
    head: list[Part] = [*report_notices(inputs), lead]
    return render_page("Report of a build", head, sections, datetime.now(UTC))


def fault_page(document: FaultsDocument) -> str:
    """Return the page of a fault campaign as HTML."""
    lead = Paragraph(
        "Faults of bus, servo, host and process, injected by name and seed while the arm moves: "
        "the required reaction beside the one observed.",
        "lead",
    )
    sections = [Section("faults", "Campaign", _campaign(document))]
    return render_page("Fault campaign", [EMULATED, lead], sections, datetime.now(UTC))


def _study(inputs: BuildInputs) -> list[Part]:
    if not inputs.studies:
        return [missing_inputs("dropstitch train --study")]
    intro = (
        "Figures 7 to 15 of the paper on the trials of this build: five payloads, two cycles of "
        "256 steps, trained on trial 1 and tested on trial 2. The paper does not state the phase "
        "by which joint 2 leads joint 1 in 2DOF. Therefore each phase has a study of its own; the "
        "2DOF predictor of the robot is trained on all phases."
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


def _plant(inputs: BuildInputs) -> list[Part]:
    parts: list[Part] = (
        [evaluation_table(inputs.evaluations)]
        if inputs.evaluations
        else [missing_inputs("dropstitch evaluate")]
    )
    if inputs.plant and (fitted := parameter_table(inputs.plant)):
        parts.append(fitted)
    return parts


def _fmus(inputs: BuildInputs) -> list[Part]:
    if not inputs.checks:
        command = "dropstitch fmu check build/twin_1dof.fmu --json > build/check_twin_1dof.json"
        return [missing_inputs(command)]
    listed = [
        f"{name}: FMI {check.fmi}, {FILE_SIZE.text(check.bytes)}, "
        f"{'all checks passed' if check.passed else 'a check failed'}"
        + "".join(
            f", {us:.0f}\u00a0{CPU_TIME.name} per step {how.replace('_', ' ')}"
            for how, us in check.step_us.items()
        )
        for name, check in inputs.checks.items()
    ]
    return [Paragraph("; ".join(listed) + "."), *fmu_tables(inputs.checks)]


def _loops(
    inputs: BuildInputs, section: Callable[[str, str, list[Part]], Section]
) -> list[Section]:
    if not inputs.loops:
        return [section("loop", "Control loop", [missing_inputs("dropstitch sil")])]
    return [section(loop.name, _loop_title(loop), _loop(loop)) for loop in inputs.loops]


def _loop_title(loop: LoopRun) -> str:
    if loop.dof is None:
        return f"Control loop on the {loop.line} line"
    phase = f", phase {ANGLE.number(loop.phase_2_rad, 0)}°" if loop.dof == 2 else ""
    return f"Control loop: {loop.dof}DOF{phase}, {loop.line} line"


def _loop(loop: LoopRun) -> list[Part]:
    parts: list[Part] = [Paragraph(verdict_sentence(loop)), *loop_figures(loop)]
    if predicted := prediction_table(loop):
        parts.append(predicted)
    if loop.in_real_time:
        parts.append(duration_table(loop))
    return [*parts, Facts(_environment(loop.timing.environment))]


def _campaign(document: FaultsDocument) -> list[Part]:
    return [
        *map(Paragraph, campaign_sentences(document)), *campaign_tables(document),
        campaign_facts(document),
    ]  # fmt: skip


def _environment(environment: SilEnvironment) -> list[tuple[str, str]]:
    """Environment of a run in display units."""
    units = {"_ns": TICK_TIME, "_kg": PAYLOAD}
    facts = []
    for name, value in msgspec.structs.asdict(environment).items():
        if value in ({}, (), None) or (name == "load_is" and not environment.load_processes):
            continue
        text = f"{value:.4g}" if isinstance(value, float) else str(value)
        for suffix, unit in units.items():
            if name.endswith(suffix):
                name, text = name.removesuffix(suffix), unit.significant(value)
        facts.append((name.replace("_", " "), text))
    return facts


def _findings(studies: Mapping[str, StudyDocument]) -> list[Part]:
    """Cards with the paper's claims and the findings of all studies; equal texts appear once."""
    if not studies:
        return [missing_inputs("dropstitch train --study")]
    badges = study_badges(studies)
    claims: dict[str, dict[Any, list[str]]] = {}
    depends_on: dict[str, list[str]] = {}
    for name, study in studies.items():
        for finding in study.findings:
            verdict = (finding.holds, finding.text.replace("trial_2", "trial 2"))
            claims.setdefault(finding.claim, {}).setdefault(verdict, []).append(badges[name])
            reasons = depends_on.setdefault(finding.claim, [])
            if finding.depends_on not in reasons:
                reasons.append(finding.depends_on)
    cards = [
        ClaimCard(
            claim,
            [(names, holds, text) for (holds, text), names in verdicts.items()],
            depends_on[claim],
        )
        for claim, verdicts in claims.items()
    ]
    intro = (
        "No parameter was tuned to reproduce the paper. A finding comes out of these trials or "
        "not, and each depends on a property that can be measured on the real link."
    )
    return [Paragraph(intro), ClaimCards(cards)]


def _made(inputs: BuildInputs) -> list[Part]:
    commands: Part = (
        CommandList(inputs.commands) if inputs.commands else missing_inputs("make demo")
    )
    origins = origin_table(inputs)
    own: list[Part] = [origins] if origins else []
    if inputs.left_out:
        own.append(Paragraph("Found and not shown: " + "; ".join(inputs.left_out) + ".", "missing"))
    return [*own, commands, Facts(_versions(inputs.manifests))]


def _versions(manifests: Mapping[int, Manifest]) -> list[tuple[str, str]]:
    versions = [("python", platform.python_version()), ("machine", platform.platform())]
    versions += [(name, importlib.metadata.version(name)) for name in LIBRARIES]
    versions += [
        (f"training data {dof}DOF", manifest.training_data_sha256[:16])
        for dof, manifest in manifests.items()
    ]
    return versions
