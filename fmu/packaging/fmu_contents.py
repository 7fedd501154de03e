"""Documents of an FMU that is given to others: reference run, documentation, terminals, icon."""

from __future__ import annotations

from typing import Final, Literal, NamedTuple

from firmware_py.motion import Motion
from firmware_py.signals import PERIOD_S
from fmu.fmu_models import FmuParts
from fmu.interface import interface_of
from fmu.packaging.plant_pages import plant_sections
from fmu.packaging.reference_run import reference_files, reference_run
from fmu.packaging.terminals import terminal_files
from fmu.stimulus import inputs_from_motion
from models.plant.step_model import StepModel
from models.shared.page_parts import Section

__all__ = ["FmuContents", "fmu_contents"]

PAYLOAD_KG: Final = 1.0
"""Payload of the reference run, the middle of the study's."""
STEPS: Final = 256
"""Steps of the reference run: one cycle of the study's motion."""


class FmuContents(NamedTuple):
    """Files by their path in the FMU, and sections of its documentation."""

    files: dict[str, bytes]
    sections: list[Section]


def fmu_contents(parts: FmuParts, model: StepModel, fmi: Literal[2, 3]) -> FmuContents:
    """Make the documents of an FMU.

    Parameters
    ----------
    parts : FmuParts
        Parts of the FMU.
    model : StepModel
        Its model.
    fmi : {2, 3}
        Version of the standard.

    Raises
    ------
    InputError
        If a part that this kind needs is absent.
    """
    u = inputs_from_motion(parts, model, Motion(dof=parts.dof), PAYLOAD_KG)[: STEPS + 1]
    related = {"documentation/index.html": "document"}
    if parts.plant:
        related["resources/plant.json"] = "model"
    files = reference_files(reference_run(model, u, PERIOD_S), related)
    files |= terminal_files(interface_of(model), fmi)
    return FmuContents(files, plant_sections(parts))
