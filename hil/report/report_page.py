"""The page: sections from what was found, one line for each that was not."""

from __future__ import annotations

import importlib.metadata
import math
import platform
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from hil.report import fault_tables, report_tables
from hil.report.build_inputs import Inputs, Json
from hil.report.loop_figures import loop_figures, stages
from hil.report.report_tables import Table, TableCell
from hil.report.study.error_figures import error_figures
from hil.report.study.estimator_figures import estimates, predictors_by_payload
from hil.report.study.motion_figures import motion_figures
from models.shared.html_page import stylesheet
from models.shared.svg_drawing import Figure

HERE: Final = Path(__file__).parent
LIBRARIES: Final = ("numpy", "scikit-learn", "onnxruntime", "casadi", "mujoco", "fmpy")


@dataclass
class Section:
    """One section; empty where its inputs are missing, then `missing` says what makes them."""

    id: str
    title: str
    intro: str = ""
    figures: list[Figure] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)
    paragraphs: list[str] = field(default_factory=list)
    facts: list[tuple[str, str]] = field(default_factory=list)
    missing: str = ""


def render(inputs: Inputs) -> str:
    """The whole page as HTML."""
    return _rendered(
        "page.html",
        glance=report_tables.at_a_glance(inputs),
        findings=_findings(inputs.every_study),
        sections=[_study(inputs), _estimators(inputs), _plant(inputs), _units(inputs),
                  *_loops(inputs), _faults(inputs)],
        commands=inputs.commands,
        versions=_versions(inputs.manifests),
    )  # fmt: skip


def render_faults(document: Json) -> str:
    """The page of a campaign of faults as HTML."""
    return _rendered("faults.html", section=_campaign(document))


def _rendered(template: str, **values: Any) -> str:
    environment = Environment(
        loader=FileSystemLoader(HERE), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    return environment.get_template(template).render(
        style=stylesheet(),
        made=datetime.now(UTC).strftime("%d %B %Y, %H:%M UTC"),
        **values,
    )


def _study(inputs: Inputs) -> Section:
    section = Section("study", "The study")
    if not inputs.studies:
        section.missing = "python -m models train"
        return section
    section.intro = (
        "The paper's figures 7 to 15 on this build's trials: five payloads, two cycles of "
        "256 steps, trained on trial 1 and tested on trial 2. The paper does not say by which "
        "phase joint 2 leads joint 1 in 2DOF, so each phase has a study of its own; the robot's "
        "2DOF predictor is trained on all of them."
    )
    section.figures = [
        *motion_figures(inputs.motions),
        *error_figures(inputs.every_study),
    ]
    return section


def _estimators(inputs: Inputs) -> Section:
    section = Section("estimators", "Predictors and estimators")
    if not inputs.studies:
        section.missing = "python -m models train"
        return section
    section.intro = (
        "On the robot nobody measures DI. The plant observer estimates it from angle and current; "
        "a lagged regressor and no DI at all stand beside it, on trial 2 and on a motion that "
        "neither training nor identification saw."
    )
    section.figures = [predictors_by_payload(inputs.studies), estimates(inputs.studies)]
    section.tables = [
        report_tables.predictors(inputs.every_study),
        report_tables.estimators(inputs.studies),
    ]
    return section


def _plant(inputs: Inputs) -> Section:
    section = Section("plant", "The plant")
    if inputs.evaluations:
        section.tables = [report_tables.plant(inputs.evaluations)]
    else:
        section.missing = "python -m models evaluate"
    if inputs.plant and (fitted := report_tables.parameters(inputs.plant)):
        section.tables.append(fitted)
    return section


def _units(inputs: Inputs) -> Section:
    section = Section("units", "The units")
    if not inputs.checks:
        section.missing = (
            "python -m fmu check build/twin_1dof.fmu --json > build/check_twin_1dof.json"
        )
        return section
    section.intro = "; ".join(
        f"{name}: FMI {check['fmi']}, {check['bytes'] / 1e3:.0f} kB, "
        f"{'sound' if check['passed'] else 'not sound'}"
        + "".join(f", {us:.0f} µs per step {what.replace('_', ' ')}"
                  for what, us in check["step_us"].items())
        for name, check in inputs.checks.items()
    ) + "."  # fmt: skip
    section.tables = report_tables.unit_checks(inputs.checks)
    return section


def _loops(inputs: Inputs) -> list[Section]:
    if not inputs.loops:
        return [Section("loop", "The loop", missing="python -m hil sil")]
    sections = []
    for loop in inputs.loops:
        phase = f", phase {math.degrees(loop.phase_2_rad):.0f}°," if loop.dof == 2 else ""
        motion = f"{loop.dof}DOF{phase} on" if loop.dof else "on"
        section = Section(
            loop.name,
            f"The loop: {motion} the {loop.line} line",
            figures=loop_figures(loop),
            paragraphs=report_tables.verdict(loop),
            facts=_facts(loop.timing["environment"]),
        )
        if predicted := report_tables.prediction(loop):
            section.tables.append(predicted)
        if loop.in_real_time:
            header = ["ms", "n", "p50", "p99", "p99.9", "max"]
            rows = [[TableCell(name), *map(TableCell, values)] for name, values in stages(loop)]
            section.tables.append(Table("Where the time goes", header, rows))
        sections.append(section)
    return sections


def _faults(inputs: Inputs) -> Section:
    if inputs.faults is None:
        return Section("faults", "Faults", missing="make faults")
    return _campaign(inputs.faults)


def _campaign(document: Json) -> Section:
    return Section(
        "faults", "Faults",
        paragraphs=fault_tables.summary(document),
        tables=fault_tables.matrix(document),
        facts=fault_tables.facts(document),
    )  # fmt: skip


def _facts(environment: Json) -> list[tuple[str, str]]:
    """What a run's environment says, in readable units."""
    facts = []
    for name, value in environment.items():
        if value in ({}, []) or (name == "load_is" and not environment["load_processes"]):
            continue
        text = f"{value:.4g}" if isinstance(value, float) else str(value)
        for suffix, unit, factor in (("_ns", "ms", 1e-6), ("_kg", "kg", 1.0)):
            if name.endswith(suffix):
                name, text = name.removesuffix(suffix), f"{factor * value:g}\u00a0{unit}"
        facts.append((name.replace("_", " "), text))
    return facts


def _findings(studies: dict[str, Json]) -> list[dict[str, Any]]:
    """The paper's findings, those of all studies under one claim; the same words stand once."""
    claims: dict[str, dict[str, Any]] = {}
    for name, study in studies.items():
        for finding in study["findings"]:
            claim = claims.setdefault(
                finding["claim"],
                {"claim": finding["claim"], "depends_on": [], "verdicts": {}},
            )
            if finding["depends_on"] not in claim["depends_on"]:
                claim["depends_on"].append(finding["depends_on"])
            said = (finding["holds"], finding["text"].replace("trial_2", "trial 2"))
            claim["verdicts"].setdefault(said, []).append(name)
    return list(claims.values())


def _versions(manifests: dict[int, Json]) -> list[tuple[str, str]]:
    versions = [("python", platform.python_version()), ("machine", platform.platform())]
    versions += [(name, importlib.metadata.version(name)) for name in LIBRARIES]
    versions += [
        (f"training data {dof}DOF", manifest["training_data_sha256"][:16])
        for dof, manifest in manifests.items()
    ]
    return versions
