"""Documents of an FMU for its users: page, reference run, icon.

The reference run is one cycle of the study's motion: its inputs, and the outputs of the interpreted
model every fourth step, as CSV files under `FOLDER`. FMPy and fmusim can read the inputs as an
input file. The inputs in row k are set at its time and hold during the step that begins there.

The equations on the page come from the docstrings of the plant's components and effects.
"""

from __future__ import annotations

import csv
import inspect
import io
import re
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import read_text
from firmware_py.core.motion import Motion
from firmware_py.core.signals import PERIOD_S
from firmware_py.core.units import LENGTH, symbol_of
from fmu.fmpy_run import inputs_from_motion, panels_by_quantity, plot_panel, usual_payload_kg
from fmu.fmu_models import MODEL_CARD, FmuParts, Kind
from fmu.interface import FmiVariable, FmiVersion, Interface
from models.plant import observer
from models.plant.components import DRIVES, LOADS
from models.plant.effects import EFFECTS, in_order
from models.plant.plant import Plant
from models.plant.step_model import StepModel, names
from models.shared.drawing import Drawing
from models.shared.pages import Figure, Paragraph, Section, Table, render_page

Array = NDArray[np.float64]

FMU_PARITY: Final = 1e-9
"""Largest difference of an FMU from the interpreted model, in SI units. [assumed: a nanometre]"""
FOLDER: Final = "extra/org.dropstitch"
INPUTS, OUTPUTS = "example_in.csv", "example_ref.csv"
_STEPS: Final = 256
"""Steps of the reference run: one cycle of the study's motion."""
_EVERY: Final = 4
"""Steps between two rows of outputs: dense enough for a motion of 4 s, with a small file."""
_MOST_TABLE_BYTES: Final = 1_000_000
"""Largest size of a table; the usual size is 40 kB. In memory, lists of text take thirty times the
size."""
_SMALLEST: Final = 1e-9
"""Amplitude below which an input counts as constant, because it is a rounding error."""
_ICON: Final = Path(__file__).parent / "icon"


class Documents(NamedTuple):
    files: dict[str, bytes]  # By path in the FMU
    sections: list[Section]  # Of the page
    example: tuple[float, ...]  # Amplitude of the example motion for each input


def fmu_documents(parts: FmuParts, model: StepModel, fmi: FmiVersion) -> Documents:
    payload_kg = usual_payload_kg(parts)
    u = inputs_from_motion(parts, model, Motion(dof=parts.dof), payload_kg, rows=_STEPS + 1)
    run = reference_run(model, u, PERIOD_S)
    icon = (_ICON / "icon.png").read_bytes()
    if fmi == 2:
        files = {"model.png": icon}
    else:
        files = {
            "terminalsAndIcons/icon.png": icon,
            "terminalsAndIcons/terminalsAndIcons.xml":
                (_ICON / "terminalsAndIcons.xml").read_bytes(),
        }  # fmt: skip
    sections = plant_sections(parts)
    sections.insert(1, _run_section(model, run))
    return Documents(reference_files(run) | files, sections, _amplitudes(u[:_STEPS]))


def _amplitudes(u: Array) -> tuple[float, ...]:
    """Amplitude of each input's sine with the period of the motion, by least squares.

    It is zero for a constant input, like a payload.
    """
    sine = np.sin(2 * np.pi * np.arange(len(u)) / len(u))
    amplitude = 2.0 / len(u) * (sine @ u)
    return tuple(float(a) if abs(a) > _SMALLEST else 0.0 for a in amplitude)


# ---- Reference run ------------------------------------------------------------------------------


class ReferenceRun(NamedTuple):
    """Inputs and expected outputs of a run."""

    step_s: float
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    u: Array  # (n, len(inputs)), row k is set at k * step_s; the last row only marks the end
    times_s: Array  # (m,), times of the outputs
    y: Array  # (m, len(outputs)), outputs


def reference_run(model: StepModel, u: Array, step_s: float) -> ReferenceRun:
    """Simulate the interpreted model.

    Shapes: `u` (n, inputs). Row k drives step k; the last row only marks the end.
    """
    times_s: Array = step_s * np.arange(len(u), dtype=np.float64)
    y = model.simulate(u[:-1], step_s)
    return ReferenceRun(
        step_s, tuple(names(model.inputs)), tuple(names(model.outputs)), u, times_s, y
    )


def reference_files(run: ReferenceRun) -> dict[str, bytes]:
    """Return the files of a reference run by their path in the FMU, with outputs thinned out."""
    return {
        f"{FOLDER}/{INPUTS}": _csv(run.inputs, run.times_s, run.u),
        f"{FOLDER}/{OUTPUTS}": _csv(run.outputs, run.times_s[::_EVERY], run.y[::_EVERY]),
    }


def read_reference_run(directory: Path) -> ReferenceRun | None:
    """Read the reference run of an unpacked FMU; None if it has none."""
    folder = directory / FOLDER
    if not (folder / INPUTS).is_file() or not (folder / OUTPUTS).is_file():
        return None
    inputs, input_times_s, u = _table(folder / INPUTS)
    outputs, times_s, y = _table(folder / OUTPUTS)
    return ReferenceRun(float(input_times_s[1]), inputs, outputs, u, times_s, y)


def _csv(columns: Sequence[str], times_s: Array, values: Array) -> bytes:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["time", *columns])
    writer.writerows([repr(float(v)) for v in row] for row in np.column_stack([times_s, values]))
    return text.getvalue().encode()


def _table(path: Path) -> tuple[tuple[str, ...], Array, Array]:
    remedy = "build the FMU again"
    text = read_text(path, remedy, _MOST_TABLE_BYTES)
    try:
        header, *rows = csv.reader(io.StringIO(text, newline=""))
        values = np.array(rows, dtype=np.float64).reshape(len(rows), len(header))
    except (ValueError, csv.Error) as error:
        raise InputError(path, f"is damaged ({error})", remedy) from None
    if len(values) < 2 or header[:1] != ["time"] or not np.all(np.isfinite(values)):
        raise InputError(path, "holds no run", remedy)
    return tuple(header[1:]), values[:, 0], values[:, 1:]


# ---- Page ---------------------------------------------------------------------------------------

_USAGE = Markup(
    "Co-Simulation with any communication step size. A value that is set between two steps "
    "acts on the outputs immediately. A refused call leaves the instance unchanged and logs "
    "one message under <code>logStatusError</code>. The folder <code>resources/</code> holds "
    "the plant and the predictor that the FMU was built from."
)

_INPUT_TIMES: Final[dict[Kind, str]] = {
    "twin": "A goal is taken at the begin of a communication step and holds over it, as a servo "
    "holds the goal that it was sent last. A host that samples a moving goal delays it by half a "
    "step on average: the angle is off by 0.39 mrad for each ms of the step at the fastest point "
    "of the study's motion. Choose the robot's 17 ms to see the robot's delay, 1 ms or less to see "
    "the link alone. In Model Exchange a goal acts at the time events only, every 17 ms, so the "
    "derivatives of the states by it are 0.",
    "observer": "Angles and currents are samples at the end of the step: set those of time t + h, "
    "then step from t to t + h. The control period of the robot is 17 ms.",
    "predictor": "The outputs follow the inputs directly; the FMU has no state. Its inputs are "
    "what the observer of the same bundle gives.",
}
"""When the inputs of each kind act; the values are measured (docs/sources.md, "FMI")."""


def documentation_page(
    interface: Interface, description: str, sections: Sequence[Section] = ()
) -> str:
    """Return documentation/index.html: description, further sections, table of variables."""
    rows = [
        [v.name, v.causality, symbol_of(v.unit), _range(v), v.description]
        for v in interface.variables
    ]
    table = Table("", ["variable", "causality", "unit", "range", "description"], rows)
    lead = [Paragraph(description, "lead"), Paragraph(_USAGE)]
    variables = Section("variables", "Variables", [Paragraph(_direct_outputs(interface)), table])
    return render_page(interface.name, lead, [*sections, variables])


def _range(variable: FmiVariable) -> str:
    limits = variable.bounds
    return f"{limits.get('min', '')} … {limits.get('max', '')}" if limits else ""


def _direct_outputs(interface: Interface) -> str:
    """Text on the outputs that depend directly on an input, as the FMU declares them."""
    direct: dict[tuple[str, ...], list[str]] = {}
    for v in interface.of("input"):
        outputs = tuple(
            o.name for o in interface.of("output")
            if v.reference in interface.dependencies[o.reference]
        )  # fmt: skip
        if outputs:
            direct.setdefault(outputs, []).append(v.name)
    parts = [f"{', '.join(inputs)} on {', '.join(outputs)}" for outputs, inputs in direct.items()]
    if not parts:
        return "No output follows a changed input directly: each changes with the next step."
    return (
        f"These inputs act within the same communication point: {'; '.join(parts)}. Whatever else "
        "an input changes, it changes with the next step."
    )


def plant_sections(parts: FmuParts) -> list[Section]:
    """Return the sections of the page on inputs, plant and predictor of an FMU."""
    sections = [Section("inputs", "When inputs act", [Paragraph(_INPUT_TIMES[parts.kind])])]
    if parts.plant:
        sections += [
            _equations(parts, parts.plant), _parameters(parts.plant), _validation(parts.plant)
        ]  # fmt: skip
    if parts.model_card():
        link = Markup('<a href="../resources/{0}">resources/{0}</a>').format(MODEL_CARD)
        text = Markup("Training data, accuracy and limits of the predictor: {}.").format(link)
        sections.append(Section("card", "Predictor", [Paragraph(text)]))
    return sections


def _run_section(model: StepModel, run: ReferenceRun) -> Section:
    units = {v.name: v.unit for v in (*model.inputs, *model.outputs)}
    columns = dict(zip((*run.inputs, *run.outputs), (*run.u.T, *run.y.T), strict=True))
    drawings = []
    for (quantity, unit), shown in panels_by_quantity(columns, units).items():
        if quantity in ("angle", "current", "DI", "tip"):
            with Drawing(2.6) as (drawing, ax):
                plot_panel(ax, run.times_s, {name: columns[name] for name in shown}, quantity, unit)
                ax.legend(
                    fontsize=7.5, frameon=False, loc="lower left", bbox_to_anchor=(0, 1), ncols=2,
                    borderpad=0,
                )  # fmt: skip
            drawings.append(drawing.panel(quantity, f"{quantity} over time: {', '.join(shown)}"))
    note = f"The same in files for other tools: {FOLDER}/{INPUTS} and {OUTPUTS}."
    return Section("run", "Reference run", [Figure("", note, drawings)])


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
    """Convert a docstring to HTML: paragraphs, and equations, one a line, after "::"."""
    blocks = []
    for block in re.split(r"\n\s*\n", _without_paths(docstring.strip())):
        if re.match(r"Attributes\n-+", block):
            break
        text = re.sub(r"`+", "", block)
        if block.startswith("    "):
            lines = re.sub(r",\s{2,}", "\n", textwrap.dedent(text)).splitlines()
            equations = Markup("").join(Markup("<span>{}</span>").format(line) for line in lines)
            blocks.append(Markup('<pre class="equations">{}</pre>').format(equations))
        else:
            html = re.sub(r"\*(\w[^*]*)\*", r"<em>\1</em>", str(escape(text)))
            blocks.append(Markup("<p>{}</p>").format(Markup(re.sub(r"::$", ":", html))))
    return Markup("").join(blocks)


def _without_paths(text: str) -> str:
    """Replace paths of the repository, which an FMU does not hold."""
    text = re.sub(r"\s\(`(?:models|firmware_py)\.[\w.]+`\)", "", text)
    return re.sub(r"docs/sources\.md,\s", "dropstitch sources, ", text)


def _parameters(plant: Plant) -> Section:
    rows = [
        [
            name, f"{p.value:.6g}", f"{p.error:.2g}" if p.error else "", symbol_of(p.unit),
            p.description, _without_paths(p.source),
        ]
        for name, p in plant.parameters.items()
    ]  # fmt: skip
    header = ["parameter", "value", "standard error", "unit", "what it is", "source"]
    return Section("parameters", "Parameters", [Table("", header, rows)])


def _validation(plant: Plant) -> Section:
    checked = Paragraph(
        f"Every output agrees with the interpreted plant within {FMU_PARITY:g} of its SI "
        "unit, at fixed and varying steps: dropstitch fmu check FILE.fmu."
    )
    held_out = plant.provenance.held_out
    if held_out is None:
        note = Paragraph("This plant was not compared with trials.", "note")
        return Section("validation", "Validation", [note, checked])
    rows = [
        [name, f"{error.rms:.4g}", f"{error.mae:.4g}", symbol_of(error.unit)]
        for name, error in held_out.signals.items()
    ]
    tested = f"on {held_out.trials} trials that the plant was not fitted to"
    if held_out.tip_rms_m is not None:
        tested += f"; end effector {LENGTH.text(held_out.tip_rms_m, 2)} RMS"
    table = Table("", ["signal", "RMS error", "mean absolute error", "unit"], rows, tested)
    return Section("validation", "Validation", [table, checked])
