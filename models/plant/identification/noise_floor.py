"""Noise floor of a plant: the residual that it leaves on trials without a hidden effect.

`identify` measures it on its trials and stores it in the plant file; the gap workflow counts
only what rises above it. Repetitions of a trial separate two parts of the variance of a residual:
`noise` is drawn anew in every trial, the error of the `model` repeats. What merely
varies between trials (pressure, friction, clock, place of the payload, frame of the motion capture)
is fitted first, within its prior. It cannot be fitted without a floor, nor the floor be measured
without it, so both are repeated a few times.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import msgspec
import numpy as np
from scipy.optimize import least_squares

from models.plant.document import FloorRecord
from models.plant.identification.fit import CORRELATED_SAMPLES, usual_error
from models.plant.identification.residual_spectra import ResidualSpectra
from models.plant.identification.trial_spectra import (
    TrialGroup,
    aligned,
    group_frequencies_hz,
    smoothed,
    trial_group_key,
)
from models.plant.identification.trial_variation import (
    VARIED_EFFECTS,
    prior_rows,
    trial_variation,
)
from models.plant.plant import Plant
from models.plant.step_model import Array
from models.trials.trial import Trial, TrialSet

PayloadSpectra = Mapping[float, Mapping[str, Array]]
"""Spectra by payload in kg and signal."""

FLOOR_ROUNDS: Final = 3  # in which floor and variation are estimated in turn [assumed]
FIT_STEPS: Final = 12  # at most, of the variation between trials [assumed]


def with_noise_floor(plant: Plant, trials: Iterable[Trial]) -> Plant:
    """Plant whose provenance also holds the noise floor of trials without any hidden effect.

    Repetitions separate noise from the model error; without any there is no floor. Trials of
    one and of two joints have a floor each.
    """
    floors: dict[str, FloorRecord] = {}
    trials = aligned(TrialSet(tuple(trials)))
    for dof in sorted({t.meta.dof for t in trials}):
        of_dof = [t for t in trials if t.meta.dof == dof]
        conditions = {(trial_group_key(t), t.meta.payload_kg) for t in of_dof}
        if len(conditions) < len(of_dof):
            floors[str(dof)] = floor_to_record(_measure_noise_floor(plant, of_dof))
    return replace(plant, provenance=msgspec.structs.replace(plant.provenance, noise_floor=floors))


def _measure_noise_floor(plant: Plant, trials: Sequence[Trial]) -> MeasuredFloor:
    """Floor of trials with one number of joints."""
    if plant.load == "link":
        plant = plant.with_effects(*VARIED_EFFECTS)
    residuals = ResidualSpectra(plant, trials, trial_variation(plant, trials))
    floor = guessed_floor(residuals)
    values = np.zeros(len(residuals.fit_parameters))
    for _ in range(FLOOR_ROUNDS):
        values = _fitted_variation(residuals, floor, values)
        rows = residuals.residuals(values)
        floor = floor_from_residuals(residuals.groups, residuals.trials, rows)
    return floor


def _fitted_variation(residuals: ResidualSpectra, floor: MeasuredFloor, start: Array) -> Array:
    """Variation of all trials with the least cost in units of a floor, priors included."""
    if not len(start):
        return start
    whiteners = [_whitener(floor, g, residuals.trials) for g in residuals.groups]
    prior = prior_rows(residuals.fit_parameters)
    every = np.ones(len(start), dtype=np.bool_)

    def whitened(spectra: Sequence[Array]) -> Array:
        rows = [
            np.einsum("skij,jsk...->isk...", w, r) for w, r in zip(whiteners, spectra, strict=True)
        ]
        return np.concatenate([r.reshape(-1, *r.shape[3:]) for r in rows])

    def residual(values: Array) -> Array:
        return np.concatenate([whitened(residuals.residuals(values)), prior @ values])

    def jacobian(values: Array) -> Array:
        return np.concatenate([-whitened(residuals.jacobian(values, every)), prior])

    if not np.isfinite(residual(start)).all():
        raise residuals.instability(residuals.residuals(start))
    deviation = np.array([q.standard_deviation for q in residuals.fit_parameters])
    solution = least_squares(
        residual, start, jacobian, x_scale=deviation, ftol=1e-4, max_nfev=FIT_STEPS,
        tr_solver="lsmr",
    )  # fmt: skip
    return np.asarray(solution.x)


# The floor


@dataclass(frozen=True)
class MeasuredFloor:
    """Spectra of the noise floor, as a plant file carries them."""

    frequency_hz: Array  # (F,)
    # (F,), variance of a coefficient by signal
    noise: Mapping[str, Array]
    model: Mapping[str, Array]
    # Mean error by motion and payload: group key → payload in kg → signal → (K,)
    curves: Mapping[str, PayloadSpectra] = field(default_factory=dict)
    repeats: float = 1.0  # Trials that went into each mean curve
    # Rest before the motion by group key of `curves`; the rig's if not listed
    rest_s: Mapping[str, float] = field(default_factory=dict)
    # Ratios of noise and model at each payload to their means
    ratios: PayloadRatios = field(default_factory=lambda: NO_RATIOS)

    def by_trial(self, signal: str, payloads_kg: Array, hz: Array) -> tuple[Array, Array]:
        """Noise and model of trials with these payloads, shape (trials, K)."""
        noise, model = (
            np.interp(hz, self.frequency_hz, table[signal]) for table in (self.noise, self.model)
        )
        largest = float(max(np.max(noise), np.max(model)))
        least = LEAST_NOISE_FRACTION * max(largest, 1e-12)
        factors = [(self.amplification(p), p) for p in payloads_kg]
        noise_by = [f * noise * self.ratios.noise_at(signal, p, hz) for f, p in factors]
        model_by = [f * model * self.ratios.model_at(signal, p, hz) for f, p in factors]
        return np.maximum(noise_by, least), np.array(model_by)

    def amplification(self, payload_kg: float) -> float:
        """Factor on the power of noise and model at a payload."""
        return 1.0


LEAST_NOISE_FRACTION: Final = 1e-9  # of a signal's largest variance: keeps matrices regular
PAYLOAD_REACH_KG: Final = 1.0  # over which the model error changes [assumed]


def _whitener(floor: MeasuredFloor, group: TrialGroup, trials: Sequence[Trial]) -> Array:
    """Inverse Cholesky factors, shape (signals, K, trials, trials).

    The model error is alike in trials i and j whose payloads are close::

        V_ij = noise_i δ_ij + √(model_i model_j) exp(−|payload_i − payload_j| / reach)
    """
    hz = group_frequencies_hz(group, trials)
    payloads_kg = np.array([trials[k].meta.payload_kg for k in group.trials])
    alike = np.exp(-np.abs(payloads_kg[:, None] - payloads_kg) / PAYLOAD_REACH_KG)
    result = []
    for signal in group.signals:
        noise, model = floor.by_trial(signal, payloads_kg, hz)
        size = np.sqrt(model).T
        variance = noise.T[:, :, None] * np.eye(len(payloads_kg))
        variance += size[:, :, None] * size[:, None, :] * alike
        result.append(np.linalg.inv(np.linalg.cholesky(variance)))
    return np.array(result)


def guessed_floor(residuals: ResidualSpectra) -> MeasuredFloor:
    """Flat floor from the usual error of each signal, before any residual is known."""
    units, noise = {v.name: v.unit for v in residuals.model.outputs}, {}
    for signal in dict.fromkeys(s for g in residuals.groups for s in g.signals):
        measured = [t.columns[signal] for t in residuals.trials if signal in t.columns]
        error = usual_error(units[signal], measured)
        noise[signal] = np.full(2, CORRELATED_SAMPLES * error**2)
    return MeasuredFloor(np.array([0.0, 1e3]), noise, {s: np.zeros(2) for s in noise})


def floor_from_residuals(
    groups: Sequence[TrialGroup],
    trials: Sequence[Trial],
    rows: Sequence[Array],
    repeated: bool = True,
) -> MeasuredFloor:
    """Floor from residual spectra (trials, signals, K) of data without a gap.

    `repeated`: whether repetitions separate noise from the model's error; otherwise all is noise.
    """
    hz = max((group_frequencies_hz(g, trials) for g in groups), key=len)
    noise: dict[str, list[Array]] = defaultdict(list)
    model: dict[str, list[Array]] = defaultdict(list)
    curves: dict[str, dict[float, dict[str, Array]]] = {}
    rest_s: dict[str, float] = {}
    ratios = NO_RATIOS
    repeats: list[float] = []
    for group, residual in zip(groups, rows, strict=True):
        group_hz = group_frequencies_hz(group, trials)
        payloads = np.array([trials[k].meta.payload_kg for k in group.trials])
        parts = {float(p): residual[payloads == p] for p in np.unique(payloads)}
        means = {p: part.mean(axis=0) for p, part in parts.items()}
        freedom = len(payloads) - len(parts)
        split = repeated and freedom > 0
        if split:
            scatter = sum(np.sum((parts[p] - means[p]) ** 2, axis=0) for p in parts) / freedom
        else:
            scatter = np.mean(residual**2, axis=0)
        varying = smoothed(scatter)
        count = len(payloads) / len(parts)
        standing = smoothed(np.mean([mean**2 for mean in means.values()], axis=0))
        standing = np.maximum(standing - varying / count, 0.0) if split else 0.0 * varying
        for b, signal in enumerate(group.signals):
            noise[signal].append(np.interp(hz, group_hz, varying[b]))
            model[signal].append(np.interp(hz, group_hz, standing[b]))
            repeats.append(count)
        if split:
            if ratios is NO_RATIOS:
                ratios = payload_ratios(group_hz, group.signals, parts)
            first = trials[group.trials[0]]
            rest_s.setdefault(group.key, first.meta.rest_samples * first.step_s)
            for p, mean in means.items():
                known = curves.setdefault(group.key, {}).setdefault(p, {})
                curves[group.key][p] = dict(zip(group.signals, mean, strict=True)) | known
    return MeasuredFloor(
        hz, averaged(noise), averaged(model), curves, float(np.mean(repeats)), rest_s, ratios
    )


def averaged(table: Mapping[str, Sequence[Array]]) -> dict[str, Array]:
    """Mean spectrum of each signal."""
    return {signal: np.mean(rows, axis=0) for signal, rows in table.items()}


# Ratios of the floor at one payload to the floor over all payloads, by frequency. A heavy payload
# brings the link near its limit: below 2 Hz two trials of one motion differ there by ten to forty
# times the power of trials without payload, and the model error grows alike. One floor for
# all payloads would hide a small effect in the trials without payload, and would take the scatter
# of the heaviest for an effect. Ratios are of power, smoothed over half the frequency to either
# side. Each is pooled with one coefficient of the common floor, because repetitions are few.

RATIO_WINDOW: Final = (0.5, 8)
"""Half width of their smoothing, as a fraction of the frequency and in coefficients at least: 17
coefficients are averaged [assumed]."""

COMMON_FRACTION: Final = 1 / 18  # weight of the common floor beside 17 coefficients


@dataclass(frozen=True)
class PayloadRatios:
    """Ratios of power by payload and signal, each of shape (F,)."""

    frequency_hz: Array  # (F,)
    noise: PayloadSpectra = field(default_factory=dict)  # Of the scatter between repetitions
    model: PayloadSpectra = field(default_factory=dict)  # Of the model error

    def noise_at(self, signal: str, payload_kg: float, hz: Array) -> Array:
        """Ratio of the noise at a payload, shape (K,); ones if none is known."""
        return self._at(self.noise, signal, payload_kg, hz)

    def model_at(self, signal: str, payload_kg: float, hz: Array) -> Array:
        """Ratio of the model error at a payload, shape (K,); ones if none is known."""
        return self._at(self.model, signal, payload_kg, hz)

    def _at(self, table: PayloadSpectra, signal: str, payload_kg: float, hz: Array) -> Array:
        """Logarithm interpolated in payload and frequency; constant beyond the ends."""
        known = sorted(p for p, rows in table.items() if signal in rows)
        if not known:
            return np.ones(len(hz))
        rows = np.log(np.array([table[p][signal] for p in known]))
        at_payload = np.array([np.interp(payload_kg, known, column) for column in rows.T])
        return np.asarray(np.exp(np.interp(hz, self.frequency_hz, at_payload)))


NO_RATIOS: Final[PayloadRatios] = PayloadRatios(np.zeros(1))


def payload_ratios(
    hz: Array, signals: Sequence[str], parts: Mapping[float, Array]
) -> PayloadRatios:
    """Ratios from residuals (repetitions, signals, K) by payload at the frequencies `hz` (K,).

    None are known if a payload or a repetition is alone.
    """
    if len(parts) < 2 or any(len(rows) < 2 for rows in parts.values()):
        return NO_RATIOS
    at = ratio_frequencies_hz(hz)

    def ratios(smooth: Mapping[float, Array]) -> PayloadSpectra:
        common = np.maximum(np.mean(list(smooth.values()), axis=0), np.finfo(float).tiny)
        pooled = {
            p: (1 - COMMON_FRACTION) * rows / common + COMMON_FRACTION for p, rows in smooth.items()
        }
        return {
            p: {s: np.interp(at, hz, row) for s, row in zip(signals, rows, strict=True)}
            for p, rows in pooled.items()
        }

    within = {p: smooth_variance(rows) for p, rows in parts.items()}
    standing = {p: smoothed(np.mean(rows, axis=0) ** 2, *RATIO_WINDOW) for p, rows in parts.items()}
    return PayloadRatios(at, ratios(within), ratios(standing))


def ratio_frequencies_hz(hz: Array) -> Array:
    """Frequencies at which ratios are stored [assumed], shape (12,)."""
    return np.geomspace(hz[1], hz[-1], 12)


def smooth_variance(repetitions: Array) -> Array:
    """Smoothed variance (signals, K) between repetitions of a trial (repetitions, signals, K)."""
    return smoothed(np.var(repetitions, axis=0, ddof=1), *RATIO_WINDOW)


# The floor in the form that a plant file stores


def floor_to_record(floor: MeasuredFloor) -> FloorRecord:
    """Floor as stored in the plant file: a spectrum is one string of numbers."""

    def text(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {k if isinstance(k, str) else f"{k:g}": text(v) for k, v in value.items()}
        return " ".join(f"{v:.4g}" for v in value)

    return FloorRecord(
        frequency_hz=text(floor.frequency_hz),
        repeats=floor.repeats,
        noise=text(floor.noise),
        model=text(floor.model),
        curves=text(floor.curves),
        rest_s=dict(floor.rest_s),
        payload_ratio_hz=text(floor.ratios.frequency_hz),
        noise_ratio=text(floor.ratios.noise),
        model_ratio=text(floor.ratios.model),
    )


def floor_from_record(record: FloorRecord) -> MeasuredFloor:
    """Floor that a plant file stores; ValueError if its lengths differ."""

    def row(text: str) -> Array:
        return np.array(text.split(), dtype=np.float64)

    def by_signal(rows: Mapping[str, str]) -> dict[str, Array]:
        return {signal: row(text) for signal, text in rows.items()}

    def by_payload(table: Mapping[str, Mapping[str, str]]) -> PayloadSpectra:
        return {float(payload_kg): by_signal(rows) for payload_kg, rows in table.items()}

    hz, noise, model = row(record.frequency_hz), by_signal(record.noise), by_signal(record.model)
    ratios = PayloadRatios(
        row(record.payload_ratio_hz), by_payload(record.noise_ratio), by_payload(record.model_ratio)
    )
    spectra = [(v, hz) for rows in (noise, model) for v in rows.values()]
    for table in (ratios.noise, ratios.model):
        spectra += [(v, ratios.frequency_hz) for rows in table.values() for v in rows.values()]
    for v, at in spectra:
        if len(v) != len(at) or not np.all(np.isfinite(v)) or np.any(v < 0):
            raise ValueError(f"{len(v)} numbers for {len(at)} frequencies, or a negative one")
    if record.repeats < 1 or noise.keys() != model.keys():
        raise ValueError("repeats, or the signals of noise and model")
    curves = {key: by_payload(table) for key, table in record.curves.items()}
    return MeasuredFloor(hz, noise, model, curves, record.repeats, record.rest_s, ratios)
