"""gap.json: what was found, for machines (docs/architecture.md), and the same in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from models.gap.diagnosis import Diagnosis
from models.gap.estimation.nuisance_bias import excessive_nuisance_bias
from models.gap.residuals.localisation import as_row, location_sentence, plain
from models.gap.residuals.spectrum import Array
from models.gap.search.look_alikes import as_document, look_alikes_of, separating_motion
from models.plant.identification.evaluation import compare_with_trials, signal_errors
from models.trials.trial import Trial
from models.trials.trial_files import TrialSet

SCHEMA = 1
MOST_CELLS = 40


def gap_document(found: Diagnosis, trials: TrialSet) -> dict[str, Any]:
    """Content of gap.json."""
    namer, naming = found.namer, found.naming
    cells, left = found.located, found.remaining
    floor = noise_floor_rms(found)
    lost = namer.estimator.problem.lost()
    fit, held_out = trials.split()
    parts = {"fitted": fit, "held_out": held_out} if len(held_out) else {"fitted": fit}
    before, after = (
        {part: errors_in_floors(plant, own, floor, lost) for part, own in parts.items()}
        for plant in (found.plant, found.improved)
    )
    return {
        "schema": SCHEMA,
        "verdict": found.verdict,
        "share_left": round(found.left, 4),
        "noise_floor": {
            "learned": namer.first.floor.learned,
            "signals": floor,
            "dispersion": round(namer.dispersion(naming.before), 4),
        },
        "strained": excessive_nuisance_bias(namer.knobs, naming.after),
        "lost_at_row": lost,
        "sentence": location_sentence(cells),
        "located": [plain(c) for c in cells if c.significant][:MOST_CELLS],
        "map": [as_row(c) for c in cells],
        "named": [_named(found, turn) for turn in range(len(naming.chosen))],
        "before": before,
        "after": after,
        "remaining": {
            "sentence": location_sentence(left),
            "located": [plain(c) for c in left if c.significant][:10],
        },
        "rejected": rejected_effects(found),
    }


def noise_floor_rms(found: Diagnosis) -> dict[str, dict[str, float]]:
    """Noise floor of each signal as root mean squares over the spectrum."""
    floor = found.namer.first.floor
    return {
        s: {"noise_rms": _rms(floor.noise[s]), "model_rms": _rms(floor.model[s]),
            "rms": _rms(floor.noise[s] + floor.model[s])}
        for s in floor.noise
    }  # fmt: skip


def _rms(variance: Array) -> float:
    return float(np.sqrt(np.mean(variance)))


def errors_in_floors(
    plant: Any, trials: Sequence[Trial], floor: Any, lost: Mapping[str, int]
) -> dict[str, dict[str, float]]:
    """Root mean square of each signal's error, and the same in noise floors.

    Rows after a joint has lost its goal (`Problem.lost`) do not count.
    """
    compared = []
    for c in compare_with_trials(plant, trials):
        end = lost.get(c.trial.name, len(c.trial))
        unused = np.where(np.arange(len(c.trial)) < end, 0.0, np.nan)
        compared.append(c._replace(simulated={s: y + unused for s, y in c.simulated.items()}))
    result = {}
    for signal, row in signal_errors(plant, compared).items():
        size = floor.get(signal, {}).get("rms", np.nan)
        result[signal] = {"rms": row.rms, "unit": row.unit, "floors": row.rms / size}
    return result


def _named(found: Diagnosis, turn: int) -> dict[str, Any]:
    """One inclusion: effects, values, evidence, look-alikes."""
    namer, naming = found.namer, found.naming
    chosen = naming.chosen[turn]
    alike = look_alikes_of(naming, turn)
    constant = [found.constancy[e] for e in chosen.effects if e in found.constancy]
    result: dict[str, Any] = {
        "effect": " + ".join(chosen.effects),
        "kept": all(e in naming.named for e in chosen.effects),
        "parameters": {
            name: {"value": q.value, "unit": q.unit, "error": q.error,
                   "before": found.plant.parameters[name].value
                   if name in found.plant.parameters else 0.0}
            for knob in namer.knobs if knob.effect in chosen.effects
            for name in knob.parameters if (q := found.improved.parameters.get(name))
        },
        "evidence": {
            "separation": chosen.separation,
            "least": chosen.least,
            "held_out_gain": chosen.held_out_gain,
            "held_out_error": chosen.held_out_error,
            "strength_spread": max((c.spread for c in constant), default=0.0),
            "strength_holds": all(c.holds for c in constant),
        },
        "look_alikes": [
            {"effect": " + ".join(c.effects), "separation": c.separation} for c in alike
        ],
    }  # fmt: skip
    if alike:
        label, sizes = separating_motion(namer, found.improved, alike, naming.named)
        result["separated_by"] = as_document(label, sizes)
    return result


def rejected_effects(found: Diagnosis) -> list[dict[str, Any]]:
    """Effects that were not named, each with its reason."""
    naming = found.naming
    refitted = {e: c for r in naming.rounds for c in r for e in c.effects}
    result = []
    for effect, size in sorted(naming.screened.items(), key=lambda row: -row[1]):
        if effect in naming.named:
            continue
        entry: dict[str, Any] = {
            "effect": effect, "separation": round(size, 3),
            "least": round(found.namer.null.least([effect]), 3),
        }  # fmt: skip
        if effect in refitted and not np.isnan(refitted[effect].held_out_gain):
            entry["reason"] = "its gain does not hold on trials left out"
        elif naming.named:
            entry["reason"] = "explains less than what was named"
        else:
            entry["reason"] = "explains no more than noise"
        if effect in naming.unexcited:
            entry["reason"] = "not excited by these trials"
        result.append(entry)
    known = {row["effect"] for row in result} | set(naming.named)
    result += [
        {"effect": e, "separation": 0.0, "least": found.namer.null.least([e]),
         "reason": "not excited by these trials"}
        for e in naming.unexcited if e not in known
    ]  # fmt: skip
    return result


def goal_not_followed_in_words(data: Mapping[str, Any]) -> str:
    """What of the trials was not used, and why; empty where all was."""
    if not data.get("lost_at_row"):
        return ""
    where = ", ".join(f"{name} from row {row}" for name, row in data["lost_at_row"].items())
    return f"not used, because the drive gave its all and the joint fell behind: {where}"


def nuisance_bias_in_words(data: Mapping[str, Any]) -> str:
    """In what all trials would have to differ alike from the usual; empty if in nothing."""
    kinds = ", ".join(
        f"{kind} by {z:+.0f} standard deviations" for kind, z in data.get("strained", {}).items()
    )
    return kinds and f"every trial would have to differ from the usual in the same way: {kinds}"


def gap_in_words(data: dict[str, Any]) -> str:
    """gap.json for people."""
    lines = [f"verdict: {data['verdict']}", data["sentence"]]
    lines += [
        text for text in (goal_not_followed_in_words(data), nuisance_bias_in_words(data)) if text
    ]
    for row in data["named"]:
        values = ", ".join(
            f"{name} = {q['value']:.4g} ± {q['error'] or 0:.2g} {q['unit']}"
            for name, q in row["parameters"].items()
        )
        lines.append(f"named: {row['effect']} (d′ {row['evidence']['separation']:.1f}); {values}")
        if row["look_alikes"]:
            others = ", ".join(c["effect"] for c in row["look_alikes"])
            motion = row["separated_by"]["motion"]
            lines.append(f"  these trials cannot tell it from {others}; {motion} would")
        if not row["evidence"]["strength_holds"]:
            spread = row["evidence"]["strength_spread"]
            lines.append(
                f"  its strength would have to differ by {spread:.0%} between payloads, signals "
                "and frequencies: it stands in for something else"
            )
    if data["verdict"] in ("reduced", "not in the catalogue"):
        lines.append("what remains: " + data["remaining"]["sentence"])
    part = "held_out" if "held_out" in data["before"] else "fitted"
    lines.append(f"{part.replace('_', '-')} trials, in noise floors, before and after:")
    for signal, row in data["before"][part].items():
        after = data["after"][part].get(signal, row)
        lines.append(f"  {signal:14s}{row['floors']:10.2f}{after['floors']:10.2f}")
    quiet = [r["effect"] for r in data["rejected"] if r["reason"].startswith("not excited")]
    if quiet:
        lines.append("not excited: " + ", ".join(quiet))
    return "\n".join(lines)
