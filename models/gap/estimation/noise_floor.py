"""Noise floor: the size of a residual where nothing is missing.

Per signal and frequency the variance of a residual's coefficient has two parts: `noise`, which is
drawn anew in every trial, and `model`, the error that the plant keeps on data without any hidden
effect, which repeats whenever a trial is repeated::

    V_ij = (noise_i + (1 − ρ) e_i) δ_ij + √(m_i m_j) exp(−|payload_i − payload_j| / reach),
    m_i = s model_i + noise_i / R + ρ e_i

so ten repetitions of one error weigh no more than one. Both grow with the payload of trial i
(`MeasuredFloor.ratios`), and by `amplification_power` where repetitions differ far more; the
spectra are means over payloads. e is the error of the equations named so far, of which a
fraction ρ = `EQUATION_ERROR_REPEATED` repeats. The plant file
carries them, and the mean curve over R repetitions of the error for every motion that `identify`
used; where a trial repeats such a motion the curve is subtracted: of the model's part only a
fraction s = `MODEL_ERROR_LEFT`² remains, and the curve's own noise is added.
At a payload without a curve a larger part remains (`models.gap.estimation.transfer`). On
another motion s = 1 and the last term is absent. Variation between trials (pressure, friction, …)
is not part of the floor: it is fitted, within its prior.

Where the plant file carries no floor, the residual's own spectrum after the nuisance fit takes its
place (`fitted_floor`): then only an effect that explains the residual better than any noise of
that spectrum counts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from models.gap.estimation.transfer import (
    Knowledge,
    PayloadCurves,
    covariance,
    motion_of,
    rows_by_payload,
    transfer_weights,
    transferred,
    unknown_fraction,
)
from models.plant.identification.noise_floor import PAYLOAD_REACH_KG, MeasuredFloor
from models.plant.identification.trial_spectra import TrialGroup, group_frequencies_hz, smoothed
from models.plant.step_model import Array
from models.trials.trial import Trial

MODEL_ERROR_LEFT: Final = 0.35
"""Fraction of the plant's own error (in amplitude) that remains after its mean curve is subtracted;
measured on changed links of drawn rigs, each left out in turn."""
EQUATION_ERROR: Final = 0.1
"""Fraction of a named effect's contribution that its equation may miss; measured: the plant
reproduces the link itself to 6 to 10 %."""
EQUATION_ERROR_REPEATED: Final = 0.8
"""Fraction of an equation's error (in power) that repeats when a trial is repeated [assumed]: near
instability no two trials are alike."""


@dataclass(frozen=True)
class NoiseFloor(MeasuredFloor):
    """Measured floor, with what a diagnosis adds to it."""

    learned: bool = True  # Whether the plant file carried it
    # Error of the equations of the effects named so far, by payload in kg and signal, (F,);
    # correlated like the model's error
    formulation: PayloadCurves = field(default_factory=dict)
    # Factor on the power of noise and model by payload in kg, where the diagnosed repetitions
    # differ far more than the floor expects; 1 at other payloads
    amplification_power: Mapping[float, float] = field(default_factory=dict)

    @classmethod
    def of(cls, measured: MeasuredFloor, learned: bool = True) -> NoiseFloor:
        """Floor of a diagnosis that begins with a measured one."""
        return cls(**vars(measured), learned=learned)

    def curves_for(
        self, group: TrialGroup, trials: Sequence[Trial]
    ) -> tuple[PayloadCurves, Knowledge]:
        """Mean error of a group by payload and signal, and how it is known.

        A curve that was measured on trials of the same motion with another length, step or rest is
        transferred (`models.gap.estimation.transfer`).
        """
        first = trials[group.trials[0]]
        rest_s = first.meta.rest_samples * first.step_s
        if group.key in self.curves and abs(self.rest_s.get(group.key, rest_s) - rest_s) < (
            first.step_s / 2
        ):
            return self.curves[group.key], "measured"
        for key, table in self.curves.items():
            if motion_of(key) != motion_of(group.key):
                continue
            rows = [(p, s, row) for p, by_signal in table.items() for s, row in by_signal.items()]
            size = min(len(row) for _, _, row in rows)
            stacked = np.array([row[:size] for _, _, row in rows])
            moved = transferred(stacked, key, self.rest_s.get(key), first, group.coefficients)
            if moved is not None:
                result: dict[float, dict[str, Array]] = {p: {} for p in table}
                for (p, s, _), row in zip(rows, moved, strict=True):
                    result[p][s] = row
                return result, "transferred"
        return {}, "unknown"

    def widened(
        self,
        groups: Sequence[TrialGroup],
        trials: Sequence[Trial],
        gap: Sequence[Array],
    ) -> NoiseFloor:
        """Floor that also allows for an error in the equation that closes the gap.

        Otherwise the few coefficients with the least noise would decide which effect fits best, and
        every named effect would need others to correct its equation.

        `gap`: residual spectra with a fitted nuisance, less the mean error, (trials, signals, K).
        """
        table: dict[float, dict[str, list[Array]]] = {}
        for group, rows in zip(groups, gap, strict=True):
            hz = group_frequencies_hz(group, trials)
            payloads = np.array([trials[k].meta.payload_kg for k in group.trials])
            for payload in np.unique(payloads):
                power = np.mean(rows[payloads == payload] ** 2, axis=0)
                by_signal = table.setdefault(float(payload), {})
                for signal, row in zip(group.signals, power, strict=True):
                    smooth = EQUATION_ERROR**2 * smoothed(row)
                    by_signal.setdefault(signal, []).append(
                        np.interp(self.frequency_hz, hz, smooth)
                    )
        return replace(
            self,
            formulation={
                p: {s: np.mean(parts, axis=0) for s, parts in by_signal.items()}
                for p, by_signal in table.items()
            },
        )

    def completed_by(self, other: NoiseFloor) -> NoiseFloor:
        """Floor with the spectra of another one for the signals that it lacks."""
        lacking = [s for s in other.noise if s not in self.noise]
        at, hz = self.frequency_hz, other.frequency_hz
        noise = {s: np.interp(at, hz, other.noise[s]) for s in lacking}
        model = {s: np.interp(at, hz, other.model[s]) for s in lacking}
        return replace(self, noise={**self.noise, **noise}, model={**self.model, **model})

    def whitener(
        self,
        group: TrialGroup,
        trials: Sequence[Trial],
    ) -> Array:
        """Inverse Cholesky factors, shape (signals, K, trials, trials).

        A signal without a floor does not count: its factors are zero.
        """
        members, hz = [trials[k] for k in group.trials], group_frequencies_hz(group, trials)
        payload = np.array([t.meta.payload_kg for t in members])
        alike = np.exp(-np.abs(payload[:, None] - payload) / PAYLOAD_REACH_KG)
        curves, _ = self.curves_for(group, trials)
        result = np.empty((len(group.signals), len(hz), len(members), len(members)))
        for s, signal in enumerate(group.signals):
            if signal not in self.noise:
                result[s] = 0.0
                continue
            measured_kg, _ = rows_by_payload(curves, signal)
            left, own_noise, unknown = 1.0, np.zeros(len(members)), np.zeros_like(alike)
            if measured_kg:
                left = MODEL_ERROR_LEFT**2
                weights = transfer_weights(payload, measured_kg, PAYLOAD_REACH_KG)
                own_noise = np.sum(weights**2, axis=1) / self.repeats
                unknown = (1 - left) * unknown_fraction(payload, measured_kg, PAYLOAD_REACH_KG)
            noise, model = self.by_trial(signal, payload, hz)
            missed = np.array([self._missed(signal, p, hz) for p in payload])
            repeated = EQUATION_ERROR_REPEATED
            shared = left * model + own_noise[:, None] * noise + repeated * missed
            drawn = noise + (1 - repeated) * missed
            variance = drawn.T[:, :, None] * np.eye(len(members))
            variance += covariance(shared, alike) + covariance(model, unknown)
            result[s] = np.linalg.inv(np.linalg.cholesky(variance))
        return result

    def amplification(self, payload_kg: float) -> float:
        """Factor on the power of noise and model at a payload."""
        return self.amplification_power.get(payload_kg, 1.0)

    def _missed(self, signal: str, payload_kg: float, hz: Array) -> Array:
        """Error of the equations named so far at a payload, shape (K,)."""
        by_signal = self.formulation.get(payload_kg, {})
        if signal not in by_signal:
            return np.zeros(len(hz))
        return np.interp(hz, self.frequency_hz, by_signal[signal])

    def mean(self, group: TrialGroup, trials: Sequence[Trial]) -> Array:
        """Expected error of the plant, shape (trials, signals, K); zero where it is unknown."""
        result = np.zeros((len(group.trials), len(group.signals), group.coefficients))
        known, _ = self.curves_for(group, trials)
        payload = [trials[k].meta.payload_kg for k in group.trials]
        for b, signal in enumerate(group.signals):
            measured_kg, rows = rows_by_payload(known, signal)
            if measured_kg:
                weights = transfer_weights(payload, measured_kg, PAYLOAD_REACH_KG)
                result[:, b] = weights @ np.array(rows)
        return result
