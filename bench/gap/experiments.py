"""Designed motions on pairs of look-alikes: how many they separate, beside the fixed motions.

::

    python -m bench.gap.experiments --plant build/plant.json --limits robot.toml

The first effect of a pair is hidden in the rig, one trial of the study's motion is recorded, and
both effects are fitted to it. Where that trial tells them apart, the effect is hidden again, so
weak that their d′ is about 2. Then a motion of 10 s is designed and compared with the motions of
the menu that the limits allow. A pair is separable where any motion reaches d′ = 3. With --verify
the motion that `models experiment` recommends is run on the rig, and both effects are fitted to
both trials.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from firmware_py.config import read_config
from firmware_py.console import Progress
from firmware_py.errors import InputError
from firmware_py.motion import Motion
from firmware_py.safety.limits import Limits
from models.gap.estimation.gauss_newton import FitPoint, GaussNewton
from models.gap.estimation.noise_floor_fit import noise_floor_for, nuisance_and_variation
from models.gap.experiment.experiment import design_experiment
from models.gap.experiment.rival import Rival
from models.gap.experiment.separation import SeparationModel
from models.gap.improved_plant import written_values
from models.gap.residuals.fit_parameters import effect_fit_parameters
from models.gap.residuals.residuals import Residuals
from models.gap.settings import DEFAULT_SETTINGS
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
INSEPARABLE: Final = DEFAULT_SETTINGS.indistinguishable_separation
"""d′ below which a pair stays together."""
LOOK_ALIKE_SEPARATION: Final = 2.0
"""d′ of a pair on the trial at hand, below that of separated pairs."""
FIT_STEPS: Final = 8
PAYLOAD_KG: Final = 1.0
PAYLOADS_KG: Final = (0.0, 1.0)
LEAST_RATIO: Final = 3.0
LEAST_FRACTION: Final = 0.9
LEAST_GAIN: Final = 0.1
"""Gain below which a ratio means nothing."""


@dataclass(frozen=True)
class PairResult:
    """Separation of one pair."""

    pair: str  # Hidden effect and its rival
    strength: float
    before: float  # d′ at hand, with the designed motion, with the best fixed one
    designed: float
    fixed: float
    gain: float  # d′ that each adds
    fixed_gain: float
    best: str  # The best fixed motion
    # D′ between the fits to the trial at hand and the recommended one, run on the rig; negative
    # where the rival fits better
    verified: float | None


def fit_of(plant: Plant, trials: Sequence[Trial], effect: str) -> tuple[FitPoint, Rival]:
    """Fit of one effect and the nuisance."""
    own = effect_fit_parameters(plant, effect, 1)
    parameters = nuisance_and_variation(plant, trials) + own
    residuals = Residuals(plant, trials, parameters)
    estimator = GaussNewton(residuals, noise_floor_for(residuals))
    free = np.ones(len(parameters), dtype=bool)
    point = estimator.fit(estimator.start(), free, FIT_STEPS)
    values = written_values(plant.with_effects(effect), parameters, point.values, free)
    return point, Rival((effect,), 0.5, values)


def at_hand(
    plant: Plant, effect: str, strength: float, rival: str, seed: int
) -> tuple[RigParameters, Trial, list[Rival], float]:
    """Rig with an effect, its trial, the fits of both effects to it, and their d′."""
    rig = read_rig("default").hide({effect: strength})
    first = run_case(rig, TrialCase(Motion(), PAYLOAD_KG, trial=1, seed=seed))
    rivals = [fit_of(plant, [first], e)[1] for e in (effect, rival)]
    return rig, first, rivals, SeparationModel(plant, [first], rivals, DEFAULT_SETTINGS).before(0)


def run_pair(
    plant: Plant,
    limits: Limits,
    effect: str,
    strength: float,
    rival: str,
    *,
    verify: bool,
    seed: int,
) -> PairResult:
    """Hide, fit, design, and compare."""
    rig, first, rivals, before = at_hand(plant, effect, strength, rival, seed)
    if before >= INSEPARABLE:
        strength *= LOOK_ALIKE_SEPARATION / before
        rig, first, rivals, before = at_hand(plant, effect, strength, rival, seed)
    found = design_experiment(rivals, plant, TrialSet((first,)), limits, 10.0, PAYLOADS_KG, seed)
    own, best = found.design.pairs[0], found.best_fixed
    verified = None
    if verify:
        effects = effect, rival
        verified = _verified(plant, rig, first, *found.recommended, effects, seed)
    return PairResult(
        pair=f"{effect} / {rival}",
        strength=strength,
        before=own.before,
        designed=own.separation,
        fixed=best.pairs[0].separation if best else own.before,
        gain=own.gained,
        fixed_gain=best.pairs[0].gained if best else 0.0,
        best=f"{best.label}, {best.payload_kg:g} kg" if best else "none",
        verified=verified,
    )


def _verified(
    plant: Plant, rig: RigParameters, first: Trial, motion: Motion, payload_kg: float,
    effects: Sequence[str], seed: int,
) -> float:  # fmt: skip
    """Root of twice the difference of the costs, negative where the rival fits better."""
    case = TrialCase(motion, payload_kg, trial=1, seed=seed)
    both = [first, run_case(rig, case)]
    costs = [fit_of(plant, both, e)[0].cost for e in effects]
    return float(np.sign(costs[1] - costs[0]) * np.sqrt(2 * abs(costs[1] - costs[0])))


def separation_figures(results: Sequence[PairResult]) -> dict[str, Any]:
    """Figures over the pairs that the trial at hand leaves together.

    Returns numbers of pairs, of look-alikes and of separable ones; of these the fraction that the
    designed motion separates, the least gains of designed and best fixed motion, and the median
    ratio of both gains.
    """
    alike = [r for r in results if r.before < INSEPARABLE]
    separable = [r for r in alike if max(r.designed, r.fixed) >= INSEPARABLE]
    known = {"pairs": len(results), "look_alikes": len(alike), "separable": len(separable)}
    if not separable:
        return known
    ratios = [r.gain / max(r.fixed_gain, LEAST_GAIN) for r in separable]
    least, fixed = min(r.gain for r in separable), min(r.fixed_gain for r in separable)
    return known | {
        "designed_fraction": float(np.mean([r.designed >= INSEPARABLE for r in separable])),
        "least_gain": least,
        "least_gain_of_fixed": fixed,
        "least_gain_ratio": least / max(fixed, LEAST_GAIN),
        "median_ratio": float(np.median(ratios)),
        "least_ratio": min(ratios),
    }


def summary(results: Sequence[PairResult]) -> str:
    """Table of the pairs, and the figures with their targets."""
    known = separation_figures(results)
    lines = ["| pair, strength hidden | d′ at hand | designed | best fixed | on the rig |"]
    lines += ["|---|---|---|---|---|"]
    lines += [
        f"| `{r.pair}`, {r.strength:.2g} | {r.before:.1f} | {r.designed:.1f} | "
        f"{r.fixed:.1f} ({r.best}) | " + ("" if r.verified is None else f"{r.verified:.1f}") + " |"
        for r in results
    ]
    lines += [f"{name}: {value:.3g}" for name, value in known.items()]
    lines.append(f"wanted: designed_fraction {LEAST_FRACTION:g}, ratio of gains {LEAST_RATIO:g}")
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the pairs and print the figures."""
    parser = argparse.ArgumentParser(prog="python -m bench.gap.experiments", description=__doc__)
    parser.add_argument("--plant", type=Path, required=True, help="plant identified on the rig")
    parser.add_argument("--limits", type=Path, default=Path("robot.toml"), help="robot.toml")
    parser.add_argument("--seed", type=int, default=5, help="of rig and search (5)")
    parser.add_argument("--only", nargs="+", help="hidden effects to take")
    parser.add_argument("--verify", action="store_true", help="run the motions on the rig")
    parser.add_argument("--out", type=Path, help="JSON file of pairs and figures")
    args = parser.parse_args(argv)
    plant, limits = read_plant(args.plant), read_config(args.limits).limits_in_force
    results = []
    wanted = [row for row in PAIRS if not args.only or row[0] in args.only]
    progress = Progress("bench.gap.experiments", len(wanted))
    for effect, strength, rival in wanted:
        try:
            own = run_pair(
                plant, limits, effect, strength, rival, verify=args.verify, seed=args.seed
            )
        except InputError as error:
            print(f"{effect} / {rival}: {error}", file=sys.stderr)
            continue
        results.append(own)
        progress.step(own.pair)
    if args.out:
        document = {**separation_figures(results), "results": [asdict(r) for r in results]}
        args.out.write_text(json.dumps(document, indent=1), encoding="utf-8")
    print(summary(results))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
