"""Sections of an FMU's documentation on its plant: inputs, equations, parameters, validation.

The equations come from the docstrings of the plant's components and effects.
"""

from __future__ import annotations

import inspect
import re
from typing import Any, Final

from markupsafe import Markup, escape

from firmware_py.core.units import LENGTH, symbol_of
from firmware_py.system.targets import FMU_PARITY
from fmu.fmu_models import FmuParts, Kind
from fmu.interface import Interface
from models.plant import observer
from models.plant.components import DRIVES, LOADS
from models.plant.effects import EFFECTS, in_order
from models.plant.plant import Plant
from models.shared.pages import Paragraph, Part, Section, Table

__all__ = ["plant_sections"]

_HELD: Final[dict[Kind, str]] = {
    "twin": "A goal is taken at the begin of a communication step and holds over it, as a servo "
    "holds the goal that it was sent last. A host that samples a moving goal delays it by half a "
    "step on average: the angle is off by 0.39 mrad for each ms of the step at the fastest point "
    "of the study's motion. Choose the robot's 17 ms to see the robot's delay, 1 ms or less to see "
    "the link alone.",
    "observer": "Angles and currents are samples at the end of the step: set those of time t + h, "
    "then step from t to t + h. The control period of the robot is 17 ms.",
    "predictor": "The outputs follow the inputs directly; the FMU has no state. Its inputs are "
    "what the observer of the same bundle gives.",
}
"""Text on how each kind holds its inputs; the values are measured (docs/sources.md, "FMI")."""


def plant_sections(parts: FmuParts, interface: Interface) -> list[Section]:
    """Return the sections on inputs, plant and predictor of an FMU."""
    held: list[Part] = [Paragraph(_HELD[parts.kind])]
    if parts.kind != "predictor":
        held.append(Paragraph(_direct_outputs(interface)))
    sections = [Section("inputs", "How inputs are held", held)]
    if parts.plant:
        sections += [_equations(parts, parts.plant), _parameters(parts.plant)]
        sections.append(_validation(parts.plant))
    card = parts.model_card()
    if card:
        sections.append(Section("card", "Model card", [Paragraph(_preformatted(card))]))
    return sections


def _direct_outputs(interface: Interface) -> str:
    """Text on the outputs that depend directly on an input, as the FMU declares them."""
    inputs = {v.reference: v.name for v in interface.of("input")}
    direct = []
    for output in interface.of("output"):
        known = interface.dependencies[output.reference]
        if of := [inputs[reference] for reference in known if reference in inputs]:
            direct.append(f"{output.name} ({', '.join(of)})")
    if not direct:
        return "No output follows a changed input directly: each changes with the next step."
    return (
        "These outputs depend directly on the inputs in brackets, and follow a change of them "
        f"within the same communication point: {', '.join(direct)}. Whatever else an input "
        "changes, it changes with the next step."
    )


def _equations(parts: FmuParts, plant: Plant) -> Section:
    made_of: list[tuple[str, Any]] = [
        (f"Load: {plant.load}", inspect.getmodule(LOADS[plant.load])),
        (f"Drive: {plant.drive}", DRIVES[plant.drive]),
    ]
    if parts.kind == "observer":
        made_of.append(("Estimate of the payload", observer))
    made_of += [(f"Effect: {name}", EFFECTS[name]) for name in in_order(plant.effects)]
    text = [
        Markup("<h3>{}</h3>").format(title) + _paragraphs(inspect.getdoc(part) or "")
        for title, part in made_of
    ]
    return Section("equations", "Equations", [Paragraph(Markup("").join(text))])


def _paragraphs(docstring: str) -> Markup:
    """Convert a docstring to HTML: paragraphs, and literal blocks after "::"."""
    blocks = []
    for block in re.split(r"\n\s*\n", docstring.strip()):
        if re.match(r"Attributes\n-+", block):
            break
        text = re.sub(r"`+", "", block)
        if block.startswith("    "):
            blocks.append(_preformatted(text))
        else:
            blocks.append(Markup("<p>{}</p>").format(re.sub(r"::$", ":", text)))
    return Markup("").join(blocks)


def _preformatted(text: str) -> Markup:
    return Markup("<pre>{}</pre>").format(escape(text))


def _parameters(plant: Plant) -> Section:
    rows = [
        [
            name, f"{p.value:.6g}", f"{p.error:.2g}" if p.error else "", symbol_of(p.unit),
            p.description, p.source,
        ]
        for name, p in plant.parameters.items()
    ]  # fmt: skip
    header = ["parameter", "value", "standard error", "unit", "what it is", "source"]
    return Section("parameters", "Parameters", [Table("", header, rows)])


def _validation(plant: Plant) -> Section:
    held_out = plant.provenance.held_out
    checked = Paragraph(
        f"Every output agrees with the interpreted plant within {FMU_PARITY:g} of its SI "
        "unit, at fixed and "
        "varying steps: dropstitch fmu check FILE.fmu. The same is replayed without Python from "
        "the files under extra/org.fmi-standard.fmi-ls-ref."
    )
    if held_out is None:
        return Section(
            "validation", "Validation",
            [Paragraph("This plant was not compared with trials.", "note"), checked],
        )  # fmt: skip
    rows = [
        [name, f"{error.rms:.4g}", f"{error.mae:.4g}", symbol_of(error.unit)]
        for name, error in held_out.signals.items()
    ]
    note = f"on {held_out.trials} trials that the plant was not fitted to"
    if held_out.tip_rms_m is not None:
        note += f"; end effector {LENGTH.text(held_out.tip_rms_m, 2)} RMS"
    table = Table("", ["signal", "RMS error", "mean absolute error", "unit"], rows, note)
    return Section("validation", "Validation", [table, checked])
