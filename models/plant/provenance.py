"""Provenance of a plant: its parent, its data, and every trial that it was fitted to.

The struct is the `provenance` table of a plant document. Only this module reads it.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import msgspec

from firmware_py.bus.servo_settings import ServoGains
from firmware_py.files.input_files import convert
from models.trials.trial import Trial
from models.trials.trial_origin import TrialOrigin, merged_origins, recorded_rig

__all__ = [
    "DofEvaluation",
    "Evaluation",
    "FittedTrial",
    "FloorRecord",
    "Provenance",
    "SignalError",
    "TipError",
    "read_provenance",
]

_WRITE_AGAIN = "write the plant again with 'dropstitch identify' or 'dropstitch gap'"


class SignalError(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Error of one simulated signal over all samples."""

    rms: float  # Root mean square error, in `unit`
    mae: float  # Mean absolute error, in `unit`
    unit: str


class TipError(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Root mean square error of the end effector; None without motion capture."""

    tip_rms_m: float | None = None
    # The same for a rigid link at the measured angles
    rigid_tip_rms_m: float | None = None


class DofEvaluation(TipError, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Errors of a plant on the trials with one number of joints."""

    signals: dict[str, SignalError]
    trials: int  # Number of trials
    payloads: dict[str, TipError] = {}  # Errors by payload in kg


class Evaluation(TipError, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Errors of a plant on trials."""

    signals: dict[str, SignalError]
    trials: int  # Number of trials
    dof: dict[str, DofEvaluation] = {}  # Errors by number of joints
    origins: tuple[TrialOrigin, ...]  # Whether the trials were simulated or measured


class FloorRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Noise floor for one number of joints; every spectrum is a string of numbers."""

    frequency_hz: str  # Frequencies of `noise` and `model`
    repeats: float  # Number of repetitions behind each mean curve
    noise: dict[str, str]  # Variance of a Fourier coefficient by noise, by signal
    model: dict[str, str]  # Variance of a Fourier coefficient by model error, by signal
    # Mean error: group of trials → payload in kg → signal → spectrum
    curves: dict[str, dict[str, dict[str, str]]]
    # Rest before the motion by group of trials; the rig's for a missing group
    rest_s: dict[str, float]
    payload_ratio_hz: str  # Frequencies of `noise_ratio` and `model_ratio`
    # Variance at one payload over its mean: payload in kg → signal → ratios
    noise_ratio: dict[str, dict[str, str]]
    model_ratio: dict[str, dict[str, str]]


class FittedTrial(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Trial that the plant was fitted to."""

    name: str  # Name for display; trials of different directories may have the same name
    sha256: str  # Hash of conditions and samples
    source: str  # `source` of the trial's conditions, such as rig, measured or recording
    rig: str = ""  # Name of the simulated rig; empty for a measured trial
    pressure_pa: float = 0.0  # Pressure of the link; 0 for other plants


class Provenance(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True
):
    """Where a plant's values come from."""

    # Hash of the plant document that the fit started from; empty for a nominal plant
    parent_sha256: str = ""
    data_sha256: str = ""  # Hash of the set of trials of the last fit, held-out ones included
    fitted_trials: tuple[FittedTrial, ...] = ()  # Trials of the last fit and of all earlier fits
    # Names of the trials that the last `identify` held out
    held_out_trials: tuple[str, ...] = ()
    fitted_parameters: tuple[str, ...] = ()  # Parameters that the last `identify` fitted
    # Root mean square residual of the last `identify` by signal, in the signal's unit
    residual_rms: dict[str, float] = {}
    # Errors on the held-out trials, or on the fitted ones if none were held out
    held_out: Evaluation | None = None
    named: tuple[str, ...] = ()  # Effects that `gap` added or changed
    noise_floor: dict[str, FloorRecord] = {}  # Noise floor by number of joints
    # Gains of the servos in the fitted trials, by joint; empty if unknown
    servo_gains: tuple[ServoGains, ...] = ()

    def fitted_with(self, trials: Iterable[Trial]) -> tuple[FittedTrial, ...]:
        """Fitted trials of this plant, followed by the new ones among `trials`.

        Trials with the same hash are the same, even under different names.
        """
        by_hash = {t.sha256: t for t in self.fitted_trials}
        for trial in trials:
            digest = trial.sha256()
            origin = trial.meta.source, recorded_rig(trial), trial.meta.pressure_pa
            by_hash.setdefault(digest, FittedTrial(trial.name, digest, *origin))
        return tuple(by_hash.values())

    @property
    def origins(self) -> tuple[TrialOrigin, ...]:
        """Origins of the fitted trials."""
        return merged_origins(TrialOrigin(t.source, t.rig) for t in self.fitted_trials)

    def was_fitted_to(self, trial: Trial) -> bool:
        """Whether the plant was fitted to this trial, under any name."""
        return trial.sha256() in {t.sha256 for t in self.fitted_trials}


def read_provenance(where: Path | str, table: object) -> Provenance:
    """Convert the decoded `provenance` table of a plant document."""
    return convert(table, Provenance, where, "provenance does not fit its form", _WRITE_AGAIN)
