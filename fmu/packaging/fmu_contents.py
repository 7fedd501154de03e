"""Documents of an FMU for its users: reference run, documentation, terminals, icon."""

from __future__ import annotations

from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.motion import Motion
from firmware_py.core.signals import PERIOD_S
from fmu.fmu_models import FmuParts
from fmu.interface import interface_of
from fmu.packaging.plant_pages import plant_sections
from fmu.packaging.reference_run import reference_files, reference_run
from fmu.packaging.terminals import terminal_files
from fmu.stimulus import inputs_from_motion, usual_payload_kg
from models.plant.step_model import StepModel
from models.shared.pages import Section

__all__ = ["FmuContents", "fmu_contents"]

STEPS: Final = 256
"""Steps of the reference run: one cycle of the study's motion."""
SMALLEST: Final = 1e-9
"""Amplitude below which an input counts as constant, because it is a rounding error."""


class FmuContents(NamedTuple):
    """Documents of an FMU."""

    files: dict[str, bytes]
    sections: list[Section]
    example: tuple[float, ...]  # Amplitude of the example motion for each input


def fmu_contents(parts: FmuParts, model: StepModel, fmi: Literal[2, 3]) -> FmuContents:
    """Make the documents of an FMU."""
    held_kg = usual_payload_kg(parts)
    u = inputs_from_motion(parts, model, Motion(dof=parts.dof), held_kg, rows=STEPS + 1)
    related = {"documentation/index.html": "document"}
    if parts.plant:
        related["resources/plant.json"] = "model"
    files = reference_files(reference_run(model, u, PERIOD_S), related)
    interface = interface_of(model)
    files |= terminal_files(interface, fmi)
    return FmuContents(files, plant_sections(parts, interface), _amplitudes(u[:STEPS]))


def _amplitudes(u: NDArray[np.float64]) -> tuple[float, ...]:
    """Amplitude of each input's sine with the period of the motion, by least squares.

    It is zero for a constant input, like a payload.
    """
    sine = np.sin(2 * np.pi * np.arange(len(u)) / len(u))
    amplitude = 2.0 / len(u) * (sine @ u)
    return tuple(float(a) if abs(a) > SMALLEST else 0.0 for a in amplitude)
