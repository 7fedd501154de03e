"""Reference run of an FMU: example inputs, and the outputs of the interpreted model.

Both are CSV files under extra/org.fmi-standard.fmi-ls-ref, listed in the manifest of FMI-LS-REF
(docs/sources.md, "FMI"). FMPy and fmusim can read the inputs as an input file. The inputs in row k
are set at its time and hold during the step that begins there. Outputs are written every fourth
step.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import read_text
from models.plant.step_model import StepModel, names

__all__ = ["FOLDER", "ReferenceRun", "read_reference_run", "reference_files", "reference_run"]

Array = NDArray[np.float64]

FOLDER: Final = "extra/org.fmi-standard.fmi-ls-ref"
INPUTS, RESULTS, MANIFEST = "example_in.csv", "example_ref.csv", "fmi-ls-manifest.xml"
TIME: Final = "time"
_EVERY: Final = 4
"""Steps between two rows of outputs: dense enough for a motion of 4 s, with a small file."""
_MOST_TABLE_BYTES: Final = 1_000_000
"""Largest size of a table; the usual size is 40 kB. In memory, lists of text take thirty times the
size."""

_NAMESPACE: Final = "http://fmi-standard.org/fmi-ls-manifest"
_VERSION: Final = "1.0.0-alpha.1"
"""Version of FMI-LS-REF, which is a draft."""


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
    rows = np.arange(0, len(u), _EVERY)
    times_s: Array = step_s * np.arange(len(u), dtype=np.float64)
    return ReferenceRun(
        step_s,
        tuple(names(model.inputs)),
        tuple(names(model.outputs)),
        u,
        times_s[rows],
        model.simulate(u[:-1], step_s)[rows],
    )


def reference_files(run: ReferenceRun, related: Mapping[str, str]) -> dict[str, bytes]:
    """Return the files of a reference run by their path in the FMU.

    The manifest also lists the `related` files, given as roles by path in the FMU.
    """
    times_s: Array = run.step_s * np.arange(len(run.u), dtype=np.float64)
    manifest = _manifest({f"../../{path}": role for path, role in related.items()})
    return {
        f"{FOLDER}/{INPUTS}": _csv(run.inputs, times_s, run.u),
        f"{FOLDER}/{RESULTS}": _csv(run.outputs, run.times_s, run.y),
        f"{FOLDER}/{MANIFEST}": manifest,
    }


def read_reference_run(directory: Path) -> ReferenceRun | None:
    """Read the reference run of an unpacked FMU; None if it has none."""
    folder = directory / FOLDER
    if not (folder / INPUTS).is_file() or not (folder / RESULTS).is_file():
        return None
    inputs, input_times_s, u = _table(folder / INPUTS)
    outputs, times_s, y = _table(folder / RESULTS)
    return ReferenceRun(float(input_times_s[1]), inputs, outputs, u, times_s, y)


def _csv(columns: Sequence[str], times_s: Array, values: Array) -> bytes:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([TIME, *columns])
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
    if len(values) < 2 or header[:1] != [TIME] or not np.all(np.isfinite(values)):
        raise InputError(path, "holds no run", remedy)
    return tuple(header[1:]), values[:, 0], values[:, 1:]


def _manifest(related: Mapping[str, str]) -> bytes:
    ET.register_namespace("fmi-ls", _NAMESPACE)
    root = ET.Element(
        "fmiReferences",
        {
            f"{{{_NAMESPACE}}}fmi-ls-name": "org.fmi-standard.fmi-ls-ref",
            f"{{{_NAMESPACE}}}fmi-ls-version": _VERSION,
            f"{{{_NAMESPACE}}}fmi-ls-description": "Layered Standard providing information on "
            "related files included in an FMU.",
        },
    )
    rows = [
        (INPUTS, "testcase", "text/csv", "inputs of the example: one cycle of the study's motion"),
        (RESULTS, "result", "text/csv", "outputs of the example, by the interpreted model"),
        *((path, role, _type(path), role) for path, role in sorted(related.items())),
    ]
    for source, role, kind, description in rows:
        attributes = {"type": kind, "source": source, "role": role, "description": description}
        ET.SubElement(root, "Related", attributes)
    ET.indent(root)
    text: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return text + b"\n"


def _type(path: str) -> str:
    return {"html": "text/html", "json": "application/json", "md": "text/markdown"}.get(
        path.rpartition(".")[2], "application/octet-stream"
    )
