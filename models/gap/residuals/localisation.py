"""Location of the gap: by signal, trial, phase, direction, stroke, region and frequency band.

The residual in noise floors is transformed back to time and its power compared region by region
with a block bootstrap: differences of repeated trials hold no common gap, so blocks of them, drawn
with random signs, show the effect of noise alone (without repetitions, white noise does). A region
counts if it stays significant under a false-discovery rate (Benjamini and Hochberg 1995). Groups of
trials are put into words from the keys that documents use.
"""

from __future__ import annotations

import itertools
import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Final

import msgspec
import numpy as np
from scipy.stats import false_discovery_control

from firmware_py.core.signals import unit_of, without_unit
from firmware_py.core.units import DURATION, TIME, symbol_of
from models.plant.identification.trial_spectra import (
    TrialGroup,
    coefficient_frequencies_hz,
    inverse_cosine_transform,
)
from models.plant.step_model import Array
from models.trials.trial import Trial

BANDS_HZ: Final = (0.0, 0.3, 0.8, 2.0, 4.0, 8.0)
"""Edges of the frequency bands [assumed]."""
PHASES: Final = 8
"""Number of parts of a period [assumed]."""
STANDING_RAD_S: Final = 0.02
"""Joint rate below which the motion counts as standing [assumed]."""
BOOTSTRAP_BLOCK_S: Final = 1.0
"""Length of a block of the bootstrap [assumed]."""
BOOTSTRAP_DRAWS: Final = 400
"""Draws of the bootstrap [assumed]."""
FALSE_DISCOVERY_RATE: Final = 0.05
"""Rate of false discoveries (Benjamini and Hochberg 1995)."""
LEAST_SAMPLES: Final = 20
"""Fewest samples of a region that is tested: one must have more [assumed]."""
LEAST_COEFFICIENTS: Final = 4
"""Fewest coefficients of a band that is tested [assumed]."""
ONE_SIDED: Final = 0.5
"""Mean of a residual, as a fraction of its root mean square, above which its sign is reported
[assumed]."""
PAYLOAD_TREND: Final = 1.5
"""Ratio of the gap at the heaviest payload to that at the lightest above which the gap is reported
to grow with payload [assumed]."""

_KEY: Final = re.compile(
    r"(?P<dof>\d+)dof (?P<motion>.+?) (?P<amplitude>[-+.\de]+)rad (?P<period>[-+.\de]+)s "
    r"(?P<phase>[-+.\de]+)rad( (?P<rows>\d+)x(?P<step>[-+.\de]+)s)?(?P<conditions>( \S+=\S+)*)"
)
"""Form of `models.plant.identification.trial_spectra.trial_group_key`; length and step may lack."""
_COUNTS: Final = {1: "one joint", 2: "two joints"}


def motion_in_words(key: str) -> str:
    """Motion and conditions of a group of trials; the key itself if it has another form."""
    match = _KEY.fullmatch(key)
    if match is None:
        return key
    amplitude, phase = (round(math.degrees(float(match[n])), 1) for n in ("amplitude", "phase"))
    dof, period_s = int(match["dof"]), float(match["period"])
    parts = [
        match["motion"].replace("_", " ") + (f" of ±{amplitude:g}°" if amplitude else ""),
        f"period {period_s:g} {TIME.name}" if period_s else "",
        f"joint 2 leads by {phase:g}°" if phase else "",
        _COUNTS.get(dof, f"{dof} joints"),
        *(_condition(text) for text in match["conditions"].split()),
    ]
    return ", ".join(filter(None, parts))


def groups_in_words(keys: Iterable[str]) -> str:
    """Groups of trials in words, with their length where two would read the same."""
    words = {key: motion_in_words(key) for key in keys}
    times = Counter(words.values())
    return "; ".join(
        phrase + (_length(key) if times[phrase] > 1 else "") for key, phrase in words.items()
    )


def _condition(text: str) -> str:
    """Condition such as "load_mass_kg=0.5" as "load mass 0.5 kg"."""
    name, _, value = text.partition("=")
    return f"{without_unit(name)} {value} {symbol_of(unit_of(name) or '1')}".rstrip()


def _length(key: str) -> str:
    match = _KEY.fullmatch(key)
    if match is None or match["rows"] is None:
        return ""
    return f", {match['rows']} rows of {DURATION.text(float(match['step']))}"


class GapRegion(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Region of a signal by one factor: trial, payload, phase, direction, angle, stroke or band.

    `size` is the root mean square and `mean` the signed mean of the residual, measured minus
    simulated, in noise floors; `p` is the fraction of draws of noise alone that are as large.
    `significant`: under the false-discovery rate.
    """

    signal: str
    factor: str
    level: str  # For example "3/8" of the phase
    size: float
    mean: float
    p: float
    significant: bool = False


def locate_gap(
    groups: Sequence[TrialGroup],
    trials: Sequence[Trial],
    white: Sequence[Array],
    seed: int = 0,
) -> list[GapRegion]:
    """Regions of all signals and factors, largest first.

    Shapes: `white` (trials, signals, K).
    """
    rng = np.random.default_rng(seed)
    regions: list[GapRegion] = []
    for group, rows in zip(groups, white, strict=True):
        members = [trials[k] for k in group.trials]
        samples, step_s = len(members[0]), members[0].step_s
        hz = coefficient_frequencies_hz(group.coefficients, samples, step_s)
        series = _series(rows, samples)
        pairs = _pairs(members, rows, samples)
        masks = _masks(members)
        block = min(max(1, round(BOOTSTRAP_BLOCK_S / step_s)), samples)
        noise = _noise(rng, pairs, series.shape, block, BOOTSTRAP_DRAWS)
        drawn = _drawn_power(noise, masks)
        for b, signal in enumerate(group.signals):
            regions += _regions(signal, series[:, b], masks, drawn)
            regions += _bands(signal, rows[:, b], hz, rng)
    significant = _significant(regions, FALSE_DISCOVERY_RATE)
    return sorted(significant, key=lambda c: (not c.significant, -c.size))


def _series(rows: Array, samples: int) -> Array:
    """Whitened residual in time with unit variance under noise, (trials, signals, n)."""
    scale = np.sqrt(samples / rows.shape[-1])
    return np.asarray(
        scale * np.moveaxis(inverse_cosine_transform(np.moveaxis(rows, -1, 0), samples), 0, -1)
    )


def _pairs(members: Sequence[Trial], rows: Array, samples: int) -> Array:
    """Differences of repeated trials over √2, (pairs · signals, n)."""
    result = []
    for a, first in enumerate(members):
        for b in range(a + 1, len(members)):
            if members[b].meta.payload_kg == first.meta.payload_kg:
                difference = _series((rows[a] - rows[b])[None] / np.sqrt(2), samples)[0]
                size = np.sqrt(np.mean(difference**2, axis=1, keepdims=True))
                result.append(difference / np.maximum(size, 1e-9))
    return np.concatenate(result) if result else np.empty((0, samples))


def _noise(
    rng: np.random.Generator, pairs: Array, shape: tuple[int, ...], block: int, draws: int
) -> Iterator[Array]:
    """Draws of noise for one signal, each (trials, n), one by one to save memory."""
    trials, samples = shape[0], shape[-1]
    if not len(pairs):
        for _ in range(draws):
            yield rng.standard_normal((trials, samples))
        return
    count = -(-samples // block)
    row = rng.integers(len(pairs), size=(draws, trials, count))
    start = rng.integers(max(samples - block, 1), size=row.shape)
    sign = rng.choice([-1.0, 1.0], size=row.shape)
    offset = np.arange(block)
    for r, s, g in zip(row, start, sign, strict=True):
        drawn = pairs[r[..., None], s[..., None] + offset] * g[..., None]
        yield drawn.reshape(trials, -1)[:, :samples]


def _drawn_power(
    noise: Iterable[Array], masks: Mapping[tuple[str, str], Array]
) -> dict[tuple[str, str], Array]:
    """Mean square of each draw in each region, (draws,)."""
    result: dict[tuple[str, str], list[float]] = {key: [] for key in masks}
    for draw in noise:
        for key, mask in masks.items():
            result[key].append(float(np.mean(draw[mask] ** 2)))
    return {key: np.array(powers) for key, powers in result.items()}


def _masks(members: Sequence[Trial]) -> dict[tuple[str, str], Array]:
    """Masks by factor and level, (trials, n)."""
    angle = np.array([t.joint[:, 0] for t in members])
    rate = np.gradient(angle, members[0].step_s, axis=1)
    time_s = np.array([t.time_s - t.time_s[t.meta.rest_samples] for t in members])
    phases = PHASES
    period_s = members[0].meta.period_s
    phases = phases if period_s > 0 else 0  # a motion without a period has no phases
    phase = np.floor(phases * ((time_s / (period_s or 1.0)) % 1.0)).astype(int)
    moving, still = time_s >= 0, STANDING_RAD_S
    third = np.max(np.abs(angle)) / 3
    masks: dict[tuple[str, str], Array] = {}
    for a, t in enumerate(members):
        only = np.zeros(angle.shape, dtype=bool)
        only[a] = True
        masks["trial", f"{t.name}"] = only
    for payload in sorted({t.meta.payload_kg for t in members}):
        chosen = np.array([t.meta.payload_kg == payload for t in members])
        masks["payload", f"{payload:g} kg"] = np.broadcast_to(chosen[:, None], angle.shape)
    for k in range(phases):
        masks["phase", f"{k + 1}/{phases}"] = (phase == k) & moving
    masks["direction", "towards +"] = rate > still
    masks["direction", "towards −"] = rate < -still
    masks["direction", "standing"] = np.abs(rate) <= still
    masks["angle", "negative"] = angle < -third
    masks["angle", "middle"] = np.abs(angle) <= third
    masks["angle", "positive"] = angle > third
    for side, name in ((angle > 0, "positive"), (angle < 0, "negative")):
        out = side & (rate * angle > 0) & (np.abs(rate) > still)
        back = side & (rate * angle < 0) & (np.abs(rate) > still)
        masks["stroke", f"way out to {name} angles"] = out
        masks["stroke", f"return from {name} angles"] = back
    return {key: mask for key, mask in masks.items() if mask.sum() > LEAST_SAMPLES}


def _regions(
    signal: str,
    series: Array,
    masks: Mapping[tuple[str, str], Array],
    noise: Mapping[tuple[str, str], Array],
) -> list[GapRegion]:
    return [
        _region(signal, factor, level, series[mask], noise[factor, level])
        for (factor, level), mask in masks.items()
    ]


def _bands(signal: str, rows: Array, hz: Array, rng: np.random.Generator) -> list[GapRegion]:
    result = []
    for low, high in itertools.pairwise(BANDS_HZ):
        chosen = rows[:, (hz >= low) & (hz < high)].ravel()
        if len(chosen) >= LEAST_COEFFICIENTS:
            drawn = rng.chisquare(len(chosen), BOOTSTRAP_DRAWS) / len(chosen)
            region = _region(signal, "band", f"{low:g} to {high:g} Hz", chosen, drawn)
            result.append(msgspec.structs.replace(region, mean=0.0))  # coefficients have no sign
    return result


def _region(signal: str, factor: str, level: str, chosen: Array, drawn: Array) -> GapRegion:
    """Region of a residual in noise floors (n,), against the power of draws of noise (draws,)."""
    power = float(np.mean(chosen**2))
    p = (1 + np.sum(drawn >= power)) / (1 + len(drawn))
    return GapRegion(signal, factor, level, power**0.5, float(np.mean(chosen)), float(p))


def _significant(regions: list[GapRegion], rate: float) -> list[GapRegion]:
    """Regions with those marked that pass the false-discovery rate; rounded for readers."""
    adjusted = false_discovery_control([c.p for c in regions]) if regions else []
    return [
        msgspec.structs.replace(
            c, size=round(c.size, 3), mean=round(c.mean, 3), p=round(c.p, 4),
            significant=bool(p <= rate),
        )
        for c, p in zip(regions, adjusted, strict=True)
    ]  # fmt: skip


IN_WORDS: Final = {
    "tip_x_m": "the tip (x)", "tip_y_m": "the tip (y)", "tip_z_m": "the tip's height",
    "di": "the Deformation Index",
}  # fmt: skip


NOTHING_LOCATED: Final = (
    "With link and set-up refitted, no signal, stroke or payload stands out from the noise floor."
)


def location_sentence(regions: Sequence[GapRegion]) -> str:
    """Location of the gap in one sentence."""
    significant = [c for c in regions if c.significant]
    if not significant:
        return NOTHING_LOCATED
    top = max(significant, key=lambda c: c.size if c.factor == "stroke" else 0.0)
    if top.factor != "stroke":
        top = significant[0]
    of_signal = [c for c in regions if c.signal == top.signal]
    where = f"on the {top.level}" if top.factor == "stroke" else f"for {top.factor} {top.level}"
    parts = [f"{signal_in_words(top.signal)} differs most {where}"]
    if abs(top.mean) > ONE_SIDED * top.size:
        side = "larger" if top.mean > 0 else "smaller"
        parts = [f"{signal_in_words(top.signal)} is measured {side} than simulated {where}"]
    parts.append(f"{top.size:.1f} noise floors")
    band = _largest(of_signal, "band")
    if band:
        parts.append(f"mostly at {band.level}")
    payload = sorted((c for c in of_signal if c.factor == "payload"), key=_payload)
    ratio = PAYLOAD_TREND
    several = len({c.level for c in payload}) > 1
    if several and payload[-1].size > ratio * payload[0].size:
        parts.append("growing with payload")
    elif several and payload[0].size > ratio * payload[-1].size:
        parts.append("falling with payload")
    return f"With link and set-up refitted, {', '.join(parts)}."


def _payload(region: GapRegion) -> float:
    return float(region.level.split()[0])


def _largest(regions: Sequence[GapRegion], factor: str) -> GapRegion | None:
    candidates = [c for c in regions if c.factor == factor and c.significant]
    return max(candidates, key=lambda c: c.size) if candidates else None


def signal_in_words(signal: str) -> str:
    if signal in IN_WORDS:
        return IN_WORDS[signal]
    quantity, joint, _ = (*signal.split("_"), "", "")[:3]
    return f"the {quantity} of joint {joint}" if joint.isdigit() else signal
