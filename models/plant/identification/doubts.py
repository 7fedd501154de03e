"""Doubts about an identification: bounds that were met, no gain over a rigid link, other weight."""

from __future__ import annotations

import math
from typing import Final

from firmware_py.display_units import LENGTH
from firmware_py.errors import InputError
from firmware_py.link.link_description import STUDY_LINK
from models.plant.identification.identification import Identification
from models.plant.parameter import bound_reached
from models.plant.plant import Plant
from models.trials.trial import TrialSet

__all__ = ["check_weight", "doubts"]

ALIKE_M_S2: Final = 0.3
"""Largest difference of two gravities that are taken for one: 2° or 3 % [assumed]."""


def doubts(found: Identification) -> list[str]:
    """What a user has to look at, one sentence each.

    Parameters
    ----------
    found : Identification
        Result of the fit.
    """
    said = []
    for q in found.fitted:
        reached = bound_reached(q)
        limit = q.low if reached == "lower" else q.high
        # Nothing of it, or the whole of a fraction, is an answer; an edge of a range is none.
        if reached and limit != 0.0 and not (q.unit == "1" and limit == 1.0):
            said.append(
                f"{q.name} is at its {reached} bound, {limit:g} {q.unit}: the trials do not "
                "determine it, or the plant lacks something that it stands in for"
            )
    for dof, error in found.held_out.dof.items():
        plant_m, rigid_m = error.tip_rms_m, error.rigid_tip_rms_m
        if plant_m is not None and rigid_m is not None and plant_m >= rigid_m:
            said.append(
                f"{dof}DOF: the plant misses the tip by {LENGTH.text(plant_m, 2)}, a rigid link by "
                f"{LENGTH.text(rigid_m, 2)}: check the link's size, mounting and the signs of the "
                "trials ('models validate')"
            )
    return said


def check_weight(plant: Plant, trials: TrialSet) -> None:
    """Refuse trials of a link that is mounted otherwise than the plant.

    Parameters
    ----------
    plant : Plant
        To fit.
    trials : TrialSet
        Of the link; those of another plant pass.

    Raises
    ------
    InputError
        If gravity in a trial differs from the plant's in direction or size.
    """
    if plant.load != "link":
        return
    unit = (plant.link or STUDY_LINK).gravity.unit
    own = tuple(plant.parameters["gravity_m_s2"].value * axis for axis in unit)
    for trial in trials:
        if math.dist(own, trial.meta.gravity) > ALIKE_M_S2:
            raise InputError(
                trial.path,
                f"gravity is {_vector(trial.meta.gravity)} m/s², in the plant {_vector(own)} m/s²",
                "name the link's file: --plant link.toml, with its mounting under [gravity]",
            )


def _vector(vector: tuple[float, ...]) -> str:
    return "[" + ", ".join(f"{value:.3g}" for value in vector) + "]"
