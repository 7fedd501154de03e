"""Designed motions on pairs of look-alikes: how many they separate, beside the fixed motions.

::

    python -m bench.gap.experiments --plant build/plant.json --limits robot.toml

The first effect of a pair is hidden in the rig, one trial of the study's motion is recorded, and
both effects are fitted to it. A pair counts where that trial cannot tell them apart. Then a motion
of 10 s is designed and compared with the motions of the menu that the limits allow. It is separable
where any motion reaches d′ = 3. With --verify the designed motion is run on the rig, and both
effects are fitted to both trials.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from firmware_py.config import read_config
from firmware_py.errors import InputError
from firmware_py.motion import Motion
from firmware_py.motion_document import MotionDocument
from firmware_py.safety.limits import Limits
from models.gap.estimation.gauss_newton import FitPoint, GaussNewton
from models.gap.estimation.noise_floor_fit import noise_floor_for, nuisance_and_variation
from models.gap.experiment.experiment import design_experiment
from models.gap.experiment.motion_design import INSEPARABLE
from models.gap.experiment.rival import Rival
from models.gap.improved_plant import written_values
from models.gap.residuals.fit_parameters import effect_fit_parameters
from models.gap.residuals.residuals import Residuals
from models.plant.plant import Plant, read_plant
from models.rig.rig_parameters import RigParameters, read_rig
from models.rig.study_protocol import run_case
from models.rig.trial_case import TrialCase
from models.trials.trial import Trial, TrialSet

PAIRS: Final = (
    ("encoder_offset", 0.02, "prebend"),
    ("prebend", 0.02, "marker_frame_tilt"),
    ("marker_frame_tilt", 0.01, "encoder_offset"),
    ("payload_offset", 0.03, "prebend"),
    ("coulomb_friction", 1.0, "load_dependent_friction"),
    ("stribeck_friction", 1.0, "coulomb_friction"),
    ("current_scale", 0.05, "torque_constant_drift"),
    ("creep", 0.1, "hysteresis"),
    ("joint_elasticity", 3e-4, "directional_stiffness"),
    ("dead_time", 0.012, "sync_offset"),
)
"""Effect that is hidden, its strength, and the effect that it is mistaken for. The first three were
declared look-alikes by diagnoses of three trials of the study's motion [chosen before any run]."""
FIT_STEPS: Final = 8
PAYLOAD_KG: Final = 1.0
PAYLOADS_KG: Final = (0.0, 1.0)
LEAST_RATIO: Final = 3.0
LEAST_FRACTION: Final = 0.9


@dataclass(frozen=True)
class PairResult:
    """Separation of one pair.

    Attributes
    ----------
    pair : str
        Hidden effect and its rival.
    before, designed, fixed : float
        d′ at hand, with the designed motion, with the best fixed one.
    gain, fixed_gain : float
        d′ that each adds.
    best : str
        The best fixed motion.
    verified : float or None
        d′ between the fits to the trial at hand and the designed one, run on the rig.
    """

    pair: str
    before: float
    designed: float
    fixed: float
    gain: float
    fixed_gain: float
    best: str
    verified: float | None


def fit_of(plant: Plant, trials: Sequence[Trial], effect: str) -> tuple[FitPoint, Rival]:
    """Fit of one effect and the nuisance.

    Parameters
    ----------
    plant : Plant
        As given.
    trials : sequence of Trial
        To fit.
    effect : str
        Of the catalogue.
    """
    own = effect_fit_parameters(plant, effect, 1)
    parameters = nuisance_and_variation(plant, trials) + own
    residuals = Residuals(plant, trials, parameters)
    estimator = GaussNewton(residuals, noise_floor_for(residuals))
    free = np.ones(len(parameters), dtype=bool)
    point = estimator.fit(estimator.start(), free, FIT_STEPS)
    values = written_values(plant.with_effects(effect), parameters, point.values, free)
    return point, Rival((effect,), 0.5, values)


def run_pair(
    plant: Plant,
    limits: Limits,
    hidden: Mapping[str, float],
    rival: str,
    *,
    verify: bool,
    seed: int,
) -> PairResult:
    """Hide, fit, design, and compare.

    Parameters
    ----------
    plant : Plant
        Identified without the effect.
    limits : Limits
        Of the robot.
    hidden : mapping of str to float
        The effect and its strength.
    rival : str
        What it is mistaken for.
    verify : bool
        Whether to run the designed motion on the rig.
    seed : int
        Of the rig and the search.
    """
    rig = read_rig("default").hide(dict(hidden))
    first = run_case(rig, TrialCase(Motion(), PAYLOAD_KG, trial=1, seed=seed))
    effects = (*hidden, rival)
    rivals = [fit_of(plant, [first], e)[1] for e in effects]
    found = design_experiment(rivals, plant, TrialSet((first,)), limits, 10.0, PAYLOADS_KG, seed)
    own, best = found.design.pairs[0], found.best_fixed
    verified = None
    if verify:
        verified = _verified(plant, rig, first, found.design.document, effects, seed)
    return PairResult(
        pair=" / ".join(effects),
        before=own.before,
        designed=own.separation,
        fixed=best.pairs[0].separation if best else own.before,
        gain=own.gained,
        fixed_gain=best.pairs[0].gained if best else 0.0,
        best=f"{best.label}, {best.payload_kg:g} kg" if best else "none",
        verified=verified,
    )


def _verified(
    plant: Plant, rig: RigParameters, first: Trial, motion: MotionDocument, effects: Sequence[str],
    seed: int,
) -> float:  # fmt: skip
    """Root of twice the difference of the costs, negative where the rival fits better."""
    case = TrialCase(Motion.designed(motion), motion.payload_kg or 0.0, trial=1, seed=seed)
    both = [first, run_case(rig, case)]
    costs = [fit_of(plant, both, e)[0].cost for e in effects]
    return float(np.sign(costs[1] - costs[0]) * np.sqrt(2 * abs(costs[1] - costs[0])))


def summary(results: Sequence[PairResult]) -> str:
    """Figures with their targets.

    Parameters
    ----------
    results : sequence of PairResult
        Of all pairs.
    """
    alike = [r for r in results if r.before < INSEPARABLE]
    separable = [r for r in alike if max(r.designed, r.fixed) >= INSEPARABLE]
    done = [r for r in separable if r.designed >= INSEPARABLE]
    lines = [f"{'pair':50} before designed fixed  gains designed/fixed (best fixed)  on the rig"]
    lines += [
        f"{r.pair:50} {r.before:6.1f} {r.designed:8.1f} {r.fixed:5.1f} {r.gain:7.1f} / "
        f"{r.fixed_gain:.1f} ({r.best})" + ("" if r.verified is None else f"  {r.verified:.1f}")
        for r in results
    ]
    lines.append(f"look-alikes on one trial: {len(alike)} of {len(results)}")
    lines.append(f"separable by some motion: {len(separable)}")
    if separable:
        share = len(done) / len(separable)
        least, fixed = min(r.gain for r in separable), min(r.fixed_gain for r in separable)
        ratios = [r.gain / max(r.fixed_gain, 0.1) for r in separable]
        lines += [
            f"separated by one designed motion of 10 s: {share:.0%} (target {LEAST_FRACTION:.0%})",
            f"least gain of d′ {least:.1f}, of the best fixed motion of each pair {fixed:.1f}: "
            f"ratio {least / max(fixed, 0.1):.1f} (target {LEAST_RATIO:g})",
            f"ratio pair by pair: least {min(ratios):.1f}, median {np.median(ratios):.1f}",
        ]
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the pairs and print the figures."""
    parser = argparse.ArgumentParser(prog="python -m bench.gap.experiments", description=__doc__)
    parser.add_argument("--plant", type=Path, required=True, help="plant identified on the rig")
    parser.add_argument("--limits", type=Path, default=Path("robot.toml"), help="robot.toml")
    parser.add_argument("--seed", type=int, default=5, help="of rig and search (5)")
    parser.add_argument("--only", nargs="+", help="hidden effects to take")
    parser.add_argument("--verify", action="store_true", help="run the motions on the rig")
    parser.add_argument("--out", type=Path, help="file of the results, JSON lines")
    args = parser.parse_args(argv)
    plant, limits = read_plant(args.plant), read_config(args.limits).limits_in_force
    results = []
    for effect, strength, rival in PAIRS:
        if args.only and effect not in args.only:
            continue
        try:
            result = run_pair(
                plant, limits, {effect: strength}, rival, verify=args.verify, seed=args.seed
            )
        except InputError as error:
            print(f"{effect} / {rival}: {error}", file=sys.stderr)
            continue
        results.append(result)
        print(result, file=sys.stderr, flush=True)
        if args.out:
            with args.out.open("a", encoding="utf-8") as file:
                file.write(json.dumps(result.__dict__) + "\n")
    print(summary(results))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
