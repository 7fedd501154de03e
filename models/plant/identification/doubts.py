"""What speaks against an identification: trials of another link, and signs of a wrong plant.

Trials of another link than the plant's are refused before a fit. What a fit cannot know (a bound
that it reached, a payload that it misses, payloads that ask for another torque constant) is a
warning of one sentence.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from firmware_py.core.errors import InputError
from firmware_py.core.units import FRACTION, LENGTH
from firmware_py.link.link_description import STUDY_LINK
from models.plant.document import DofEvaluation, Evaluation
from models.plant.identification.fit import (
    LARGEST_DERIVATIVE,
    LINK_SIGNALS,
    Objective,
    free_parameters,
)
from models.plant.parameter import Parameter, bound_reached
from models.plant.plant import Plant
from models.trials.checks.payloads import payload_unit_cause
from models.trials.trial import LINK_SIZES, Trial, TrialMeta, link_differences


def refuse_other_links(plant: Plant, where: Path | str, trials: Sequence[Trial]) -> None:
    """Refuse trials of several links, and trials of another link than the plant's.

    Links differ in size, gravity or largest payload: the observer's estimate of the payload is
    limited to the most that the link carries. A plant that is no link has nothing to compare.
    """
    link = plant.link
    for trial in trials if plant.load == "link" else ():
        for name, of_trial, of_plant in differences_from_plant(trial.meta, plant):
            raise InputError(
                trial.path,
                f"{name} is {of_trial}, in the plant {where} {of_plant}",
                "correct the one that is wrong, or name the file of this link: --plant link.toml",
            )
        for name, of_trial, of_first in link_differences(trial.meta, trials[0].meta):
            raise InputError(
                trial.path,
                f"{name} is {of_trial}, in {trials[0].path} {of_first}",
                "correct it, or keep the trials of each link in a directory of their own",
            )
        payload_kg = trial.meta.payload_kg
        if link is not None and payload_kg > link.most_payload_kg:
            raise InputError(
                trial.path,
                f"has a payload of {payload_kg:g} kg, a plant of this link takes "
                f"{link.most_payload_kg:g} kg at most",
                f"raise payload_kg in the link's file, now {link.payload_kg:g}, and name that "
                "file: --plant link.toml",
            )


def differences_from_plant(meta: TrialMeta, plant: Plant) -> list[tuple[str, str, str]]:
    """Conditions by which a trial is of another link than a plant: name, and both values.

    Sizes that the trial does not state are not compared, nor its markers.
    """
    unit = (plant.link or STUDY_LINK).gravity.unit
    gravity = tuple(plant.parameters["gravity_m_s2"].value * axis for axis in unit)
    sizes = {name: plant.parameters[name].value for name in LINK_SIZES if meta.link_length_m}
    of_plant = msgspec.structs.replace(meta, gravity_m_s2=gravity, **sizes)
    return [row for row in link_differences(meta, of_plant) if row[0] != "markers"]


MOST_DEFLECTION: Final = 0.3
"""Root mean square error of a rigid link, relative to its length, that no bend explains. The rig's
link has 0.067 at 2 kg (its root carries about 13 N·m) and 0.24 where its wall wrinkles, at 46 N·m
(docs/sources.md, "The link"); an arc of 35 degrees has 0.3."""


def doubts(fitted: Sequence[Parameter], held_out: Evaluation) -> list[str]:
    """Warnings about an identification, one sentence each."""
    warnings = []
    for q in fitted:
        reached = bound_reached(q)
        limit = q.low if reached == "lower" else q.high
        # Zero, or all of a fraction, is a valid result; any other bound is not.
        if reached and limit != 0.0 and not (q.unit == "1" and limit == 1.0):
            warnings.append(
                f"{q.name} is at its {reached} bound, {limit:g} {q.unit}: the trials do not "
                "determine it, or the plant lacks something that it stands in for"
            )
    for dof, error in held_out.dof.items():
        warnings += _no_better_than_rigid(dof, error) or _payload_missed(dof, error)
    return warnings


def evaluation_doubts(result: Evaluation, plant: Plant) -> list[str]:
    """Warnings about a comparison of a plant with trials, one sentence each."""
    warnings = []
    for dof, error in result.dof.items():
        rigid_m, length = error.rigid_tip_rms_m, plant.parameters.get("link_length_m")
        if rigid_m is not None and length and rigid_m > MOST_DEFLECTION * length.value:
            warnings.append(
                f"{dof}DOF: the measured tip is {LENGTH.text(rigid_m, 0)} from that of a rigid "
                f"link, {FRACTION.text(rigid_m / length.value)} of the link's length, and no link "
                "bends so far: check tip, units, angles and size of the trials "
                "('dropstitch validate')"
            )
        else:
            warnings += _no_better_than_rigid(dof, error)
    return warnings


def _no_better_than_rigid(dof: str, error: DofEvaluation) -> list[str]:
    """Warn of a plant whose tip error is not below that of a rigid link."""
    plant_m, rigid_m = error.tip_rms_m, error.rigid_tip_rms_m
    if plant_m is None or rigid_m is None or plant_m < rigid_m:
        return []
    return [
        f"{dof}DOF: the plant misses the tip by {LENGTH.text(plant_m, 2)}, a rigid link by "
        f"{LENGTH.text(rigid_m, 2)}: check the link's size, mounting and the signs of the "
        "trials ('dropstitch validate')"
    ]


def _payload_missed(dof: str, error: DofEvaluation) -> list[str]:
    """Warn of the payload with the largest tip error, if it is a large part of the deflection.

    What the clock explains is not the plant's. The limits are 5 mm and a tenth of the deflection
    [assumed; 10 of 133 plants of drawn rigs exceed them].
    """
    errors = [
        (tip.clock_tip_rms_m or tip.tip_rms_m, tip.rigid_tip_rms_m, load)
        for load, tip in error.payloads.items()
        if float(load) > 0 and tip.tip_rms_m is not None and tip.rigid_tip_rms_m is not None
    ]
    plant_m, deflection_m, load = max(errors, default=(0.0, 0.0, ""))
    if plant_m < max(5e-3, 0.1 * deflection_m):
        return []
    return [
        f"{dof}DOF with {load} kg: the plant misses the tip by {LENGTH.text(plant_m, 2)}, "
        f"{100 * plant_m / deflection_m:.0f} % of its deflection: the link may be near the moment "
        "at which it folds, where its bend scatters from run to run; give the gap workflow trials "
        "with less payload"
    ]


def torque_constant_doubts(plant: Plant, trials: Sequence[Trial]) -> list[str]:
    """Warnings, one per joint whose torque constant disagrees with the payloads.

    The plant takes the torque per ampere from the servo's data sheet. If it is wrong, masses,
    inertia and friction are wrong by the same factor. But the payloads are known, so the difference
    in current between two payloads does not match their weight. One step of a fit tells.

    A warning needs a difference of a tenth and of five standard deviations [assumed: a servo's
    constant is within some per cent of its model's; on rigs with the right value the fit was within
    2 %; model errors are larger than noise].
    """
    planes = max(t.meta.dof for t in trials)
    declared = [f"torque_constant_{j}_nm_a" for j in range(1, planes + 1)]
    known = plant.parameters
    constants = [n for n in declared if n in known and known[n].role == "fixed"]
    if plant.load != "link" or not constants or len({t.meta.payload_kg for t in trials}) < 2:
        return []
    free = free_parameters(plant, trials)[0] + constants
    rms = plant.provenance.residual_rms
    objective = Objective(plant, "driven", trials, free, LINK_SIGNALS, rms)
    residual, slopes = objective(objective.start)
    if not np.abs(slopes).max() < LARGEST_DERIVATIVE:  # a payload that no twin carries
        return []
    information = slopes.T @ slopes
    step = -np.linalg.solve(information, slopes.T @ residual)
    deviation = np.sqrt(np.diag(np.linalg.inv(information)))
    warnings = []
    for name in constants:
        k, value = free.index(name), known[name].value
        if abs(step[k]) <= max(0.1 * value, 5 * deviation[k]):
            continue
        inverse = 1 - step[k] / value  # the current is linear in the constant's inverse
        if inverse < 0.1:  # No servo has ten times the torque per ampere of its model [assumed].
            warnings.append(
                f"the current of joint {name.split('_')[2]} does not grow with the payload as "
                "its weight does: check the sign and the unit of the current, and the declared "
                "payloads"
            )
        else:
            unit = payload_unit_cause(inverse, deviation[k] / value)
            units = f", or the payloads are {unit}" if unit else ""
            warnings.append(
                f"the payloads speak for {name} of about {value / inverse:.2g} N.m/A, not "
                f"{value:.3g}: give that of your servo in link.toml, or fit it (role = "
                f'"nuisance" in the file given to --plant){units}'
            )
    return warnings
