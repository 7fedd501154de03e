"""One case of the benchmark: hide, simulate, diagnose, test on sealed trials."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np

from bench.gap.cases import PAYLOAD_SETS, BenchCase, motion_named
from bench.gap.sealed_errors import SealedErrors
from firmware_py.errors import InputError
from models.gap.diagnosis import Diagnosis, diagnose
from models.gap.equation_error import read_equation_error
from models.gap.estimation.model_discrepancy import ModelDiscrepancy
from models.plant.parameter import bound_reached
from models.plant.plant import Plant
from models.rig.drawn_rig import rig_named
from models.rig.rig_parameters import RigParameters
from models.rig.study_protocol import run_case
from models.rig.trial_case import TrialCase
from models.trials.trial import Trial, TrialSet

HANGING_RAD = 0.1
"""Following error at the start from which the arm hangs: its current limit does not hold it
[assumed]."""
DELAY_OF = {"dead_time": "goal_delay_1_s"}
"""Parameters in which a plant without the effect holds the rig's own."""


def run_bench_case(
    case: BenchCase,
    plant: Plant,
    times: dict[str, float],
    with_sealed: bool = True,
    patterns: Sequence[ModelDiscrepancy] = (),
) -> dict[str, Any]:
    """Run a case; return its result. Long because every result is handed over once.

    `times`: receives the time of the diagnosis, and that of the processor.
    `patterns`: of the plant's own error; for other motions those shipped.
    """
    rig = rig_of(case)
    try:
        own = bench_trials(
            rig.hide(case.added_to_rig), case.seed, case.joints, case.motion, case.payloads
        )
        trials = TrialSet(tuple(own))
    except InputError as error:
        return {"impossible": str(error)}
    start_s, cpu_s = time.perf_counter(), time.process_time()
    leave_out = list(case.hidden) if case.kind == "outside" else []
    found = diagnose(plant, trials, leave_out=leave_out, settings=case.settings, patterns=patterns)
    times |= {"wall_s": time.perf_counter() - start_s, "cpu_s": time.process_time() - cpu_s}
    known = found.fitted.parameters
    written = found.improved.parameters != found.plant.parameters
    sealed = SealedErrors(rig, case) if written and with_sealed else None
    return {
        "verdict": found.verdict,
        "named": list(found.named),
        "separate_joints": found.settings.separate_joints,
        "chosen": [list(c.effects) for c in found.inclusions],
        "separation": [c.separation for c in found.inclusions],
        "hypotheses": [
            [h.effects, h.squared_separation, h.squared_least, h.probability]
            for h in found.hypotheses
        ],
        "effects": len(found.screened),
        "tested": msgspec.to_builtins(found.tested),
        "bias": found.nuisance_bias,
        "refused": [[r.effect, r.kind, r.name, r.value, r.limit] for r in found.refused],
        "look_alikes": [[list(a.effects) for a in c.look_alikes] for c in found.inclusions],
        "largest": max(found.screened.values(), default=0.0),
        "true": {e: true_strength(plant, rig, e, s) for e, s in case.hidden.items()},
        "own": {e: found.screened.get(e) for e in case.hidden},
        "null_standard_deviation": {
            e: found.null_distribution.least([e]) / found.null_distribution.threshold
            for e in case.hidden
        },
        "estimates": {
            effect: [
                [known[n].value, known[n].error, plant_value(plant, n)]
                for q in found.fit_parameters if q.effect == effect
                for n in q.parameters if n in known
            ]
            for effect in found.named
        },
        "equation_error": {e: read_equation_error().fraction(e) for e in found.named},
        "sealed_tested": with_sealed,
        "sealed": sealed and sealed.in_noise_floors(plant, found.improved),
        "sealed_rms": sealed.rms(plant, found.improved) if sealed else {},
        "unsaid_bounds": unsaid_bounds(found),
        "amplification_power": {f"{kg:g}": p for kg, p in found.amplification_power.items()},
        "left": [found.residual_before, found.residual_after, found.gap_left_fraction],
        "strength_consistency": {
            e: [c.standard_deviation, c.probability] for e, c in found.strength_consistency.items()
        },
        "separable": separable(plant, trials, case, found.named, patterns),
    }  # fmt: skip


def separable(
    plant: Plant,
    trials: TrialSet,
    case: BenchCase,
    stand_ins: Sequence[str],
    patterns: Sequence[ModelDiscrepancy] = (),
) -> bool:
    """Whether the whole catalogue tells a denied effect from its stand-ins.

    It does where it names the effect, and no stand-in is among the declared look-alikes.
    """
    if case.kind != "outside":
        return True
    found = diagnose(plant, trials, settings=case.settings, patterns=patterns)
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


def unsaid_bounds(found: Diagnosis) -> list[str]:
    """Refitted nuisance of the improved plant that came to a bound: nothing tells it.

    The workflow is to refuse such a value, so that none is left. The bound of a named effect's
    parameter is told beside it, and `identify` tells that of a parameter of the plant as given.
    """
    given, improved = found.plant.parameters, found.improved.parameters
    refitted = {
        name
        for q in found.fit_parameters
        for name in q.parameters
        if q.trial is None and name in given and q.effect not in found.named
    }
    return sorted(
        name
        for name in refitted
        if bound_reached(improved[name]) not in (None, bound_reached(given[name]))
    )


def rig_of(case: BenchCase) -> RigParameters:
    """Rig of a case, without the hidden effects."""
    rig = rig_named(case.rig)
    turns = {f"sensor.frame_{name}_rad": turn for name, turn in case.frame_turn_rad.items()}
    factors = {name: factor * rig[name] for name, factor in case.nuisance.items()}
    return rig.changed(**factors, **turns)


def bench_trials(
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
