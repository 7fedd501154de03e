"""One data set: hide effects in the rig, run trials, diagnose them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np

from firmware_py.errors import InputError
from models.gap.diagnosis import diagnose
from models.gap.equation_error import read_equation_error
from models.gap.training.cases import PAYLOAD_SETS, HiddenCase, motion_named
from models.plant.plant import Plant
from models.rig.drawn import rig_named
from models.rig.parameters import RigParameters
from models.rig.protocol import TrialCase, run_case
from models.trials.trial import Trial, TrialSet

HANGING_RAD = 0.1
"""Following error at the start from which the arm hangs: its current limit does not hold it
[assumed]."""
DELAY_OF = {"dead_time": "goal_delay_1_s"}
"""Parameters in which a plant without the effect holds the rig's own."""


def run_hidden_case(case: HiddenCase, plant: Plant) -> dict[str, Any]:
    """Run a case and return its result; `impossible` says why nobody would record these trials."""
    rig = rig_of(case)
    try:
        trials = TrialSet(tuple(study_trials(rig.hide(case.hidden), case.seed, case.joints)))
    except InputError as error:
        return {"impossible": str(error)}
    leave_out = list(case.hidden) if case.kind == "outside" else []
    found = diagnose(plant, trials, leave_out=leave_out)
    known = found.fitted.parameters
    return {
        "verdict": found.verdict,
        "named": list(found.named),
        "chosen": [list(c.effects) for c in found.inclusions],
        "look_alikes": [[list(a.effects) for a in c.look_alikes] for c in found.inclusions],
        "hypotheses": [
            [h.effects, h.squared_separation, h.squared_least, h.probability]
            for h in found.hypotheses
        ],
        "effects": len(found.screened),
        "tested": msgspec.to_builtins(found.tested),
        "true": {e: true_strength(plant, rig, e, s) for e, s in case.hidden.items()},
        "estimates": {
            effect: [
                [known[n].value, known[n].error, plant_value(plant, n)]
                for q in found.fit_parameters if q.effect == effect
                for n in q.parameters if n in known
            ]
            for effect in found.named
        },
        "equation_error": {e: read_equation_error().fraction(e) for e in found.named},
        "separable": separable(plant, trials, case, found.named),
    }  # fmt: skip


def separable(plant: Plant, trials: TrialSet, case: HiddenCase, stand_ins: Sequence[str]) -> bool:
    """Whether the whole catalogue tells a denied effect from its stand-ins.

    It does where it names the effect, and no stand-in is among the declared look-alikes.
    """
    if case.kind != "outside":
        return True
    found = diagnose(plant, trials)
    alike = {
        e for c in found.inclusions if set(c.effects) & set(case.hidden)
        for a in c.look_alikes for e in a.effects
    }  # fmt: skip
    return set(case.hidden) <= set(found.named) and not alike & set(stand_ins)


def plant_value(plant: Plant, name: str) -> float:
    """Value before the diagnosis; zero where the plant did not hold the effect."""
    return plant.parameters[name].value if name in plant.parameters else 0.0


def true_strength(plant: Plant, rig: RigParameters, effect: str, hidden: float) -> float:
    """Change that is to be found.

    Where the plant has no such effect, nor a parameter for it, the rig's own is added.
    """
    known = effect in plant.effects or DELAY_OF.get(effect) in plant.parameters
    return hidden if known else hidden + rig[rig.effects()[effect]]


def rig_of(case: HiddenCase) -> RigParameters:
    """Rig of a case, without the hidden effects."""
    rig = rig_named(case.rig)
    turns = {f"sensor.frame_{name}_rad": turn for name, turn in case.frame_turn_rad.items()}
    factors = {name: factor * rig[name] for name, factor in case.nuisance.items()}
    return rig.changed(**factors, **turns)


def study_trials(
    rig: RigParameters,
    seed: int,
    joints: int = 1,
    motion: str = "study",
    payloads: str = "study",
) -> list[Trial]:
    """Trials of some payloads, each repeated once."""
    trials = [
        run_case(rig, TrialCase(motion_named(motion, joints), payload, trial, seed))
        for payload in PAYLOAD_SETS[payloads]
        for trial in (1, 2)
    ]
    for trial in trials:
        off_rad = float(np.abs(trial.angle_rad[0] - trial.goal_rad[0]).max())
        if off_rad > HANGING_RAD:
            raise InputError(trial.name, f"starts {off_rad:.2f} rad off its goal", "use less load")
    return trials
