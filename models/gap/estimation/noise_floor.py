"""The noise floor: what a residual may be without anything missing.

Per signal and frequency the variance of a residual's coefficient has two parts: `noise`, which is
drawn anew in every trial, and `model`, the error that the plant keeps on data without any hidden
effect, which repeats whenever a trial is repeated::

    V = noise · I + (s model + noise / R) · C,   C_ij = exp(−|payload_i − payload_j| / 1 kg)

so ten repetitions of one mistake weigh no more than one. The plant file carries both, and the mean
curve over R repetitions of the error for every motion that `identify` saw; where a trial repeats
such a motion the curve is subtracted: of the model's part only a share s = `CARRIED`² remains, and
the curve's own noise comes in. Elsewhere s = 1 and the last term is absent. Variation between
trials (pressure, friction, …) is not in here: it is fitted, within its spread, as knobs.

Where the plant file carries no floor, the residual's own spectrum after the nuisance fit stands
for it (`floor_of_residual`): only what an effect explains better than any noise of that spectrum
counts then.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from models.gap.residuals.residuals import TrialGroup
from models.gap.residuals.spectrum import Array, coefficient_frequencies_hz, smoothed_power
from models.trials.trial import Trial

CARRIED: Final = 0.35
"""Share of the model's error (in amplitude) that neither its mean curve nor the patterns of
`models.gap.estimation.model_discrepancy` take away: measured on links left
out when those were learned."""

FORMULATION: Final = 0.1
"""Share of a named effect's contribution that its equation may miss: the plant reproduces the link
itself to 6 to 10 %."""

REPEATED: Final = 0.8
"""Share of an equation's error (in power) that repeats when a trial is repeated: near instability
no two trials are alike."""

PAYLOAD_REACH_KG: Final = 1.0
"""Difference in payload over which the model's error changes."""

LEAST: Final = 1e-9
"""Least share of a signal's largest variance that counts as noise: keeps the matrices regular."""


@dataclass(frozen=True)
class NoiseFloor:
    """Spectra of the noise floor.

    Attributes
    ----------
    frequency_hz : ndarray, shape (F,)
        Of the spectra.
    noise, model : dict of str to ndarray, shape (F,)
        Variance of a coefficient by signal.
    curves : dict
        Mean error by motion and payload: group key → payload in kg → signal → (K,).
    repeats : float
        Trials that went into each mean curve.
    learned : bool
        Whether the plant file carried it.
    formulation : dict of str to ndarray, shape (F,)
        What the equations of the effects named so far may miss; shared like the model's error.
    """

    frequency_hz: Array
    noise: Mapping[str, Array]
    model: Mapping[str, Array]
    curves: Mapping[str, Mapping[float, Mapping[str, Array]]] = field(default_factory=dict)
    repeats: float = 1.0
    learned: bool = True
    formulation: Mapping[str, Array] = field(default_factory=dict)

    def widened(
        self, groups: Sequence[TrialGroup], trials: Sequence[Trial], gap: Sequence[Array]
    ) -> NoiseFloor:
        """Floor that also allows for an error in the equation of what closes the gap: a share.

        Without it the few coefficients with the least noise would decide which effect fits best,
        and every name would need others to mend what its equation misses.

        Parameters
        ----------
        gap : list of ndarray, shape (trials, signals, K)
            Residual spectra of the plant whose nuisance was fitted, less the mean error.
        """
        table: dict[str, list[Array]] = {}
        for group, rows in zip(groups, gap, strict=True):
            hz = group_frequencies_hz(group, trials)
            power = FORMULATION**2 * np.mean(rows**2, axis=0)
            for signal, row in zip(group.signals, power, strict=True):
                table.setdefault(signal, []).append(
                    np.interp(self.frequency_hz, hz, smoothed_power(row))
                )
        return replace(self, formulation={s: np.mean(rows, axis=0) for s, rows in table.items()})

    def whitener(self, group: TrialGroup, trials: Sequence[Trial]) -> Array:
        """Inverse Cholesky factors, shape (signals, K, trials, trials)."""
        own, hz = [trials[k] for k in group.trials], group_frequencies_hz(group, trials)
        payload = np.array([t.meta.payload_kg for t in own])
        alike = np.exp(-np.abs(payload[:, None] - payload) / PAYLOAD_REACH_KG)
        known = group.key in self.curves
        left, own_noise = (CARRIED**2, 1 / self.repeats) if known else (1.0, 0.0)
        result = np.empty((len(group.signals), len(hz), len(own), len(own)))
        for s, signal in enumerate(group.signals):
            noise, model = (
                np.interp(hz, self.frequency_hz, table[signal])
                for table in (self.noise, self.model)
            )
            largest = float(max(np.max(noise), np.max(model)))
            noise = np.maximum(noise, LEAST * max(largest, 1e-12))
            shared = left * model + own_noise * noise
            if signal in self.formulation:
                missed = np.interp(hz, self.frequency_hz, self.formulation[signal])
                shared += REPEATED * missed
                noise = noise + (1 - REPEATED) * missed
            variance = noise[:, None, None] * np.eye(len(own)) + shared[:, None, None] * alike
            result[s] = np.linalg.inv(np.linalg.cholesky(variance))
        return result

    def mean(self, group: TrialGroup, trials: Sequence[Trial]) -> Array:
        """Error to expect of the plant, shape (trials, signals, K); zero where none is known."""
        result = np.zeros((len(group.trials), len(group.signals), group.coefficients))
        known = self.curves.get(group.key, {})
        if not known:
            return result
        payloads = np.array(sorted(known))
        for a, k in enumerate(group.trials):
            payload = trials[k].meta.payload_kg
            for b, signal in enumerate(group.signals):
                table = np.array([known[p][signal] for p in payloads])
                result[a, b] = _between(payload, payloads, table)
        return result


def _between(at: float, places: Array, table: Array) -> Array:
    """Linear interpolation of rows; beyond the ends the last row holds."""
    at = float(np.clip(at, places[0], places[-1]))
    above = int(np.clip(np.searchsorted(places, at), 1, max(len(places) - 1, 1)))
    if len(places) == 1:
        return np.asarray(table[0])
    share = (at - places[above - 1]) / (places[above] - places[above - 1])
    return np.asarray((1 - share) * table[above - 1] + share * table[above])


def group_frequencies_hz(group: TrialGroup, trials: Sequence[Trial]) -> Array:
    """Frequencies of the coefficients of a group."""
    first = trials[group.trials[0]]
    return coefficient_frequencies_hz(len(first), first.step_s)


def flat_floor(signals: Sequence[str], scale: Mapping[str, float]) -> NoiseFloor:
    """Flat floor of the given errors, twelve samples counting as one.

    docs/sources.md, "Naming a missing effect".
    """
    hz = np.array([0.0, 1e3])
    noise = {s: np.full(2, 12 * scale[s] ** 2) for s in signals}
    return NoiseFloor(hz, noise, {s: np.zeros(2) for s in signals}, learned=False)


def floor_of_residual(
    groups: Sequence[TrialGroup], trials: Sequence[Trial], rows: Sequence[Array]
) -> NoiseFloor:
    """Floor that is the smoothed spectrum of a residual."""
    return floor_from_residuals(groups, trials, rows, repeated=False)


def floor_from_residuals(
    groups: Sequence[TrialGroup],
    trials: Sequence[Trial],
    rows: Sequence[Array],
    repeated: bool = True,
) -> NoiseFloor:
    """Floor from residuals of data without a gap.

    Parameters
    ----------
    groups, trials : sequence
        Of the problem.
    rows : list of ndarray, shape (trials, signals, K)
        Residual spectra by group, variation between trials taken out.
    repeated : bool
        Whether to tell noise from the model's error by repetitions; without any, all is noise.
    """
    hz = max((group_frequencies_hz(g, trials) for g in groups), key=len)
    signals = list(dict.fromkeys(s for g in groups for s in g.signals))
    noise: dict[str, list[Array]] = {s: [] for s in signals}
    model: dict[str, list[Array]] = {s: [] for s in signals}
    curves: dict[str, dict[float, dict[str, Array]]] = {}
    repeats = []
    for group, residual in zip(groups, rows, strict=True):
        own = group_frequencies_hz(group, trials)
        payloads = np.array([trials[k].meta.payload_kg for k in group.trials])
        parts = [residual[payloads == p] for p in np.unique(payloads)]
        within = [np.sum((p - p.mean(axis=0)) ** 2, axis=0) for p in parts if len(p) > 1]
        freedom = sum(len(p) - 1 for p in parts)
        split = repeated and freedom > 0
        for b, signal in enumerate(group.signals):
            if split:
                varying = smoothed_power(sum(w[b] for w in within) / freedom)
            else:
                varying = smoothed_power(np.mean(residual[:, b] ** 2, axis=0))
            mean_power = smoothed_power(np.mean([p.mean(axis=0)[b] ** 2 for p in parts], axis=0))
            count = len(group.trials) / len(parts)
            repeats.append(count)
            standing = np.maximum(mean_power - varying / count, 0.0) if split else 0 * varying
            noise[signal].append(np.interp(hz, own, varying))
            model[signal].append(np.interp(hz, own, standing))
        if split:
            curves[group.key] = {
                float(p): {s: part.mean(axis=0)[b] for b, s in enumerate(group.signals)}
                for p, part in zip(np.unique(payloads), parts, strict=True)
            }
    return NoiseFloor(
        hz, _averaged(noise), _averaged(model), curves, float(np.mean(repeats)), repeated
    )


def _averaged(table: Mapping[str, Sequence[Array]]) -> dict[str, Array]:
    return {signal: np.mean(rows, axis=0) for signal, rows in table.items()}


def floor_to_plain(floor: NoiseFloor) -> dict[str, Any]:
    """Plain form of a floor for the plant file: a series of numbers is one string."""
    return {
        "frequency_hz": _text(floor.frequency_hz),
        "repeats": floor.repeats,
        "noise": {s: _text(v) for s, v in floor.noise.items()},
        "model": {s: _text(v) for s, v in floor.model.items()},
        "curves": {
            key: {f"{p:g}": {s: _text(v) for s, v in own.items()} for p, own in table.items()}
            for key, table in floor.curves.items()
        },
    }


def floor_from_plain(document: Mapping[str, Any]) -> NoiseFloor:
    """Floor from its plain form."""
    return NoiseFloor(
        _row(document["frequency_hz"]),
        {s: _row(v) for s, v in document["noise"].items()},
        {s: _row(v) for s, v in document["model"].items()},
        {
            key: {float(p): {s: _row(v) for s, v in own.items()} for p, own in table.items()}
            for key, table in document["curves"].items()
        },
        document["repeats"],
    )


def _text(row: Array) -> str:
    return " ".join(f"{v:.4g}" for v in row)


def _row(text: str) -> Array:
    return np.array(text.split(), dtype=np.float64)
