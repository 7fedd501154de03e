"""Numbers of the page: what was hidden and named, errors of unit and robot before and after."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from hil.report.build_inputs import Json, LoopRun
from hil.report.gap.gap_inputs import GapInputs
from models.gap.report.gap_json import GapDocument, NamedEffect
from models.plant.identification.evaluation import TIP, compare_with_trials
from models.plant.plant import Plant

PART: Final = "motion"
"""Part of the robot's programme that is judged: rest and glide are not in any training."""
LEAST_GAP: Final = 1.1
"""Error before, over the error without the effect, from which on a share of the gap is told."""


def summary(inputs: GapInputs, hidden: Mapping[str, float]) -> dict[str, Any]:
    """All figures, in SI units.

    Returns
    -------
    dict
        `verdict`; `hidden` (effect → hidden, found, error, said); `also_named`; `unit`: by variant
        tip_rms_m, share_removed, worst_difference from the plant in Python, sound; `robot` over
        all payloads and `robot_heaviest`: by variant tip_mean_m and interval_coverage,
        share_removed; `heaviest_kg`.
    """
    tip_m = {
        variant: _rms([unit["rms"][axis] for unit in runs.values() for axis in TIP], len(TIP))
        for variant, runs in inputs.units.items()
    }
    heaviest_kg = max(inputs.loops["before"])
    return {
        "verdict": inputs.found.verdict,
        "hidden": {effect: _found(inputs, effect, s) for effect, s in hidden.items()},
        "also_named": [e for e in named_in(inputs.found) if e not in hidden],
        "unit": {
            "tip_rms_m": tip_m,
            "share_removed": share_removed(tip_m),
            "worst_difference": max(_difference(inputs, v) for v in ("before", "after")),
            "sound": inputs.check["passed"],
        },
        "robot": _robot(inputs, sorted(inputs.loops["before"])),
        "robot_heaviest": _robot(inputs, [heaviest_kg]),
        "heaviest_kg": heaviest_kg,
    }


def share_removed(error: Mapping[str, float | None]) -> float | None:
    """Share of the gap that is gone; None where it was less than a tenth of what is always left."""
    before, after, without = (error.get(v) for v in ("before", "after", "without"))
    if before is None or after is None or without is None or before <= LEAST_GAP * without:
        return None
    return (before - after) / (before - without)


def judged_of(loop: LoopRun) -> Json | None:
    """Prediction error in the part that is judged; None where the run has none of it."""
    parts: Json = loop.timing["prediction_error"].get("parts", {})
    return parts.get(PART)


def named_in(found: GapDocument) -> dict[str, NamedEffect]:
    """Row of gap.json for every effect that was named and kept."""
    return {e: row for row in found.named if row.kept for e in row.effect.split(" + ")}


def in_words(data: Mapping[str, Any]) -> str:
    """The figures for people; the last line names the page."""
    lines = ["; ".join(row["said"] for row in data["hidden"].values()) or "nothing was hidden"]
    lines += [f"{name} was named too" for name in data["also_named"]]
    unit, robot, heaviest = data["unit"], data["robot"], data["robot_heaviest"]
    lines += [
        "twin in FMPy, tip RMS: " + _by_variant(unit["tip_rms_m"], unit["share_removed"]),
        f"  {same_in_python(unit['worst_difference'])}",
        "robot, predicted tip: " + _by_variant(robot["tip_mean_m"], robot["share_removed"]),
        f"  at {data['heaviest_kg']:g} kg: "
        + _by_variant(heaviest["tip_mean_m"], heaviest["share_removed"]),
        str(data["report"]),
    ]
    return "\n".join(lines)


def same_in_python(worst: float) -> str:
    """How near units in FMPy and plants in Python are."""
    if worst == 0.0:
        return "bit for bit what the plants in Python give"
    return f"within {worst:.0e} (SI units) of the plants in Python"


def _by_variant(error: Mapping[str, float | None], share: float | None) -> str:
    said = ", ".join(f"{e * 1e3:.1f} mm {v}" for v, e in error.items() if e is not None)
    return said + ("" if share is None else f"; {100 * share:.0f} % of the gap is gone")


def _robot(inputs: GapInputs, payloads: list[float]) -> dict[str, Any]:
    judged = {
        variant: [judged_of(loops[kg]) if kg in loops else None for kg in payloads]
        for variant, loops in inputs.loops.items()
    }
    mean_m = {v: _mean(rows, "mean_euclidean_distance_m") for v, rows in judged.items()}
    return {
        "tip_mean_m": mean_m,
        "share_removed": share_removed(mean_m),
        "interval_coverage": {v: _mean(r, "interval_coverage") for v, r in judged.items()},
    }


def _found(inputs: GapInputs, effect: str, strength: float) -> dict[str, Any]:
    """What became of an effect that was hidden: the change of its strength, and a sentence."""
    words = effect.replace("_", " ")
    result: dict[str, Any] = {"hidden": strength, "found": None, "error": None}
    if row := named_in(inputs.found).get(effect):
        strengths = inputs.after.strengths(effect, inputs.trials[0].meta.dof)
        q = row.parameters[strengths[0]]  # the same in every joint of a servo
        result |= {"found": q.value - q.before, "error": q.error}
        found, error = result["found"], q.error or 0.0
        return result | {"said": f"{words}: {strength:g} hidden, {found:.3g} ± {error:.1g} found"}
    for name, other in named_in(inputs.found).items():
        if effect in [e for alike in other.look_alikes for e in alike.effect.split(" + ")]:
            instead = name.replace("_", " ")
            said = f"{words} was hidden; {instead} was named, as far as these trials can tell"
            return result | {"said": said}
    return result | {"said": f"{words} was hidden and not named"}


def _difference(inputs: GapInputs, variant: str) -> float:
    """Largest difference of a unit in FMPy from its plant in Python, over all trials and signals.

    In SI units; amperes, radians and metres alike are far above it where something is wrong.
    """
    plant: Plant = getattr(inputs, variant)
    worst = 0.0
    for row in compare_with_trials(plant, inputs.sealed):
        run = inputs.outputs[variant].get(row.trial.meta.payload_kg)
        for signal, values in row.simulated.items():
            if run is not None and signal in (run.dtype.names or ()):
                worst = max(worst, float(np.max(np.abs(run[signal] - values))))
    return worst


def _rms(values: list[float], axes: int) -> float:
    """Root mean square distance from the root mean squares of its coordinates."""
    return float(np.sqrt(axes * np.mean(np.square(values))))


def _mean(rows: list[Json | None], key: str) -> float | None:
    """Mean over the runs; None where one of them lacks it."""
    values = [row[key] for row in rows if row is not None]
    return float(np.mean(values)) if values and len(values) == len(rows) else None
