"""Where the gap is: by signal, trial, phase, direction of motion, region and frequency band.

The residual in noise floors is brought back to time and its power compared cell by cell with a
block bootstrap: differences of repeated trials hold no common gap, so blocks of them, drawn with
random signs, say what noise alone does (without repetitions, white noise does). A cell counts where
it stays significant under a false-discovery rate of 5 % (Benjamini and Hochberg 1995).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from models.gap.residuals.residuals import TrialGroup
from models.gap.residuals.spectrum import (
    Array,
    coefficient_frequencies_hz,
    inverse_cosine_transform,
)
from models.trials.trial import Trial

BANDS_HZ: Final = (0.0, 0.3, 0.8, 2.0, 4.0, 8.0)
PHASES: Final = 8
BLOCK_S: Final = 1.0
DRAWS: Final = 400
FALSE_DISCOVERY: Final = 0.05
REST_RAD_S: Final = 0.02
"""Joint rate below which the motion counts as standing."""


@dataclass(frozen=True)
class GapRegion:
    """One cell of one way to look at a signal.

    Attributes
    ----------
    signal, factor, level : str
        For example tip_x_m, "phase", "3/8".
    floors : float
        Root mean square of the residual in noise floors; 1 is noise.
    mean : float
        Its mean, with sign: measured minus simulated.
    p : float
        Share of the null's draws that are as large.
    significant : bool
        Under the false-discovery rate.
    """

    signal: str
    factor: str
    level: str
    floors: float
    mean: float
    p: float
    significant: bool = False


def locate_gap(
    groups: Sequence[TrialGroup], trials: Sequence[Trial], white: Sequence[Array], seed: int = 0
) -> list[GapRegion]:
    """Cells of all signals and factors, largest first.

    Parameters
    ----------
    groups, trials : sequence
        Of the problem.
    white : list of ndarray, shape (trials, signals, K)
        Residual in noise floors.
    seed : int
        Of the bootstrap.
    """
    rng = np.random.default_rng(seed)
    cells: list[GapRegion] = []
    for group, rows in zip(groups, white, strict=True):
        own = [trials[k] for k in group.trials]
        series = _series(rows, len(own[0]))
        pairs = _pairs(own, rows, len(own[0]))
        masks = _masks(own)
        null = _null(rng, pairs, series.shape, round(BLOCK_S / own[0].step_s))
        for b, signal in enumerate(group.signals):
            cells += _cells(signal, series[:, b], masks, null)
            cells += _bands(
                signal, rows[:, b], coefficient_frequencies_hz(len(own[0]), own[0].step_s), rng
            )
    return sorted(_discover(cells), key=lambda c: (not c.significant, -c.floors))


def _series(rows: Array, samples: int) -> Array:
    """Whitened residual in time with unit variance under noise, (trials, signals, n)."""
    scale = np.sqrt(samples / rows.shape[-1])
    return np.asarray(
        scale * np.moveaxis(inverse_cosine_transform(np.moveaxis(rows, -1, 0), samples), 0, -1)
    )


def _pairs(own: Sequence[Trial], rows: Array, samples: int) -> Array:
    """Differences of repeated trials over √2, (pairs · signals, n)."""
    result = []
    for a, first in enumerate(own):
        for b in range(a + 1, len(own)):
            if own[b].meta.payload_kg == first.meta.payload_kg:
                difference = _series((rows[a] - rows[b])[None] / np.sqrt(2), samples)[0]
                size = np.sqrt(np.mean(difference**2, axis=1, keepdims=True))
                result.append(difference / np.maximum(size, 1e-9))
    return np.concatenate(result) if result else np.empty((0, samples))


def _null(rng: np.random.Generator, pairs: Array, shape: tuple[int, ...], block: int) -> Array:
    """Draws of noise for one signal, (draws, trials, n)."""
    trials, samples = shape[0], shape[-1]
    if not len(pairs):
        return rng.standard_normal((DRAWS, trials, samples))
    count = -(-samples // block)
    row = rng.integers(len(pairs), size=(DRAWS, trials, count))
    start = rng.integers(max(samples - block, 1), size=row.shape)
    sign = rng.choice([-1.0, 1.0], size=row.shape)
    offset = np.arange(block)
    drawn = pairs[row[..., None], start[..., None] + offset] * sign[..., None]
    return np.asarray(drawn.reshape(DRAWS, trials, -1)[..., :samples])


def _masks(own: Sequence[Trial]) -> dict[tuple[str, str], Array]:
    """Weights by factor and level, (trials, n)."""
    angle = np.array([t.joint[:, 0] for t in own])
    rate = np.gradient(angle, own[0].step_s, axis=1)
    time_s = np.array([t.time_s - t.time_s[t.meta.rest_samples] for t in own])
    phase = np.floor(PHASES * ((time_s / own[0].meta.period_s) % 1.0)).astype(int)
    moving = time_s >= 0
    third = np.max(np.abs(angle)) / 3
    masks: dict[tuple[str, str], Array] = {}
    for a, t in enumerate(own):
        only = np.zeros(angle.shape, dtype=bool)
        only[a] = True
        masks["trial", f"{t.name}"] = only
    for payload in sorted({t.meta.payload_kg for t in own}):
        chosen = np.array([t.meta.payload_kg == payload for t in own])
        masks["payload", f"{payload:g} kg"] = np.broadcast_to(chosen[:, None], angle.shape)
    for k in range(PHASES):
        masks["phase", f"{k + 1}/{PHASES}"] = (phase == k) & moving
    masks["direction", "towards +"] = rate > REST_RAD_S
    masks["direction", "towards −"] = rate < -REST_RAD_S
    masks["direction", "standing"] = np.abs(rate) <= REST_RAD_S
    masks["angle", "negative"] = angle < -third
    masks["angle", "middle"] = np.abs(angle) <= third
    masks["angle", "positive"] = angle > third
    for side, name in ((angle > 0, "positive"), (angle < 0, "negative")):
        out = side & (rate * angle > 0) & (np.abs(rate) > REST_RAD_S)
        back = side & (rate * angle < 0) & (np.abs(rate) > REST_RAD_S)
        masks["stroke", f"way out to {name} angles"] = out
        masks["stroke", f"return from {name} angles"] = back
    return {key: mask for key, mask in masks.items() if mask.sum() > 20}


def _cells(
    signal: str, series: Array, masks: dict[tuple[str, str], Array], null: Array
) -> list[GapRegion]:
    result = []
    for (factor, level), mask in masks.items():
        chosen = series[mask]
        power = float(np.mean(chosen**2))
        drawn = np.mean(null[:, mask] ** 2, axis=1)
        p = (1 + np.sum(drawn >= power)) / (1 + len(drawn))
        result.append(
            GapRegion(
                signal, factor, level, float(np.sqrt(power)), float(np.mean(chosen)), float(p)
            )
        )
    return result


def _bands(signal: str, rows: Array, hz: Array, rng: np.random.Generator) -> list[GapRegion]:
    result = []
    for low, high in itertools.pairwise(BANDS_HZ):
        chosen = rows[:, (hz >= low) & (hz < high)].ravel()
        if len(chosen) < 4:
            continue
        power = float(np.mean(chosen**2))
        drawn = rng.chisquare(len(chosen), DRAWS) / len(chosen)
        p = (1 + np.sum(drawn >= power)) / (1 + DRAWS)
        level = f"{low:g} to {high:g} Hz"
        result.append(GapRegion(signal, "band", level, float(np.sqrt(power)), 0.0, float(p)))
    return result


def _discover(cells: list[GapRegion]) -> list[GapRegion]:
    """Mark the cells that pass the false-discovery rate."""
    order = sorted(range(len(cells)), key=lambda k: cells[k].p)
    limit = 0
    for rank, k in enumerate(order, start=1):
        if cells[k].p <= FALSE_DISCOVERY * rank / len(cells):
            limit = rank
    passed = set(order[:limit])
    return [replace(c, significant=k in passed) for k, c in enumerate(cells)]


SPOKEN: Final = {
    "tip_x_m": "the tip (x)", "tip_y_m": "the tip (y)", "tip_z_m": "the tip's height",
    "di": "the Deformation Index",
}  # fmt: skip


def location_sentence(cells: Sequence[GapRegion]) -> str:
    """Where the gap is, in one sentence."""
    found = [c for c in cells if c.significant]
    if not found:
        return "Simulation and measurement agree within the noise floor."
    top = max(found, key=lambda c: c.floors if c.factor == "stroke" else 0.0)
    if top.factor != "stroke":
        top = found[0]
    own = [c for c in cells if c.signal == top.signal]
    where = f"on the {top.level}" if top.factor == "stroke" else f"{top.factor} {top.level}"
    side = ""
    if abs(top.mean) > 0.5 * top.floors:
        side = " too large" if top.mean > 0 else " too small"
    band = _largest(own, "band")
    parts = [f"{signal_in_words(top.signal)} is off most {where}"]
    if side:
        parts = [f"{signal_in_words(top.signal)} is measured{side} for the plant {where}"]
    parts.append(f"{top.floors:.1f} noise floors")
    if band:
        parts.append(f"mostly at {band.level}")
    payload = sorted((c for c in own if c.factor == "payload"), key=_payload)
    if len(payload) > 1 and payload[-1].floors > 1.5 * payload[0].floors:
        parts.append("growing with payload")
    elif len(payload) > 1 and payload[0].floors > 1.5 * payload[-1].floors:
        parts.append("falling with payload")
    text = ", ".join(parts) + "."
    return text[0].upper() + text[1:]


def _payload(cell: GapRegion) -> float:
    return float(cell.level.split()[0])


def _largest(cells: Sequence[GapRegion], factor: str) -> GapRegion | None:
    own = [c for c in cells if c.factor == factor and c.significant]
    return max(own, key=lambda c: c.floors) if own else None


def signal_in_words(signal: str) -> str:
    """A signal in words."""
    if signal in SPOKEN:
        return SPOKEN[signal]
    what, joint, _ = (*signal.split("_"), "", "")[:3]
    return f"the {what} of joint {joint}" if joint.isdigit() else signal


def plain(cell: GapRegion) -> dict[str, Any]:
    """Plain form of a cell for gap.json; sizes are in noise floors."""
    return {
        "signal": cell.signal, cell.factor: cell.level, "size": round(cell.floors, 3),
        "mean": round(cell.mean, 3), "p": round(cell.p, 4),
    }  # fmt: skip


def as_row(cell: GapRegion) -> dict[str, Any]:
    """A cell of the map that gap.json holds, whether significant or not."""
    return {
        "signal": cell.signal, "factor": cell.factor, "level": cell.level,
        "size": round(cell.floors, 3), "significant": cell.significant,
    }  # fmt: skip
