"""Provenance of a plant: its parent, its data, and every trial that its values were fitted to.

The struct is the `provenance` table of a plant document. It is read and written here only.
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
    """Error of one simulated signal over all rows.

    Attributes
    ----------
    rms, mae : float
        Root mean square and mean absolute error, in `unit`.
    unit : str
        SI unit of the signal.
    """

    rms: float
    mae: float
    unit: str


class TipError(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Root mean square distance from the measured end effector; None without motion capture.

    Attributes
    ----------
    tip_rms_m : float or None
        Of the plant, in m.
    rigid_tip_rms_m : float or None
        Of a link that does not bend at the measured angles, in m.
    """

    tip_rms_m: float | None = None
    rigid_tip_rms_m: float | None = None


class DofEvaluation(TipError, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Errors on the trials of one number of joints.

    Attributes
    ----------
    signals : dict of str to SignalError
        By name.
    trials : int
        Number of trials.
    payloads : dict of str to TipError
        By payload in kg.
    """

    signals: dict[str, SignalError]
    trials: int
    payloads: dict[str, TipError] = {}


class Evaluation(TipError, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Errors of a plant on trials.

    Attributes
    ----------
    signals : dict of str to SignalError
        By name.
    trials : int
        Number of trials.
    dof : dict of str to DofEvaluation
        The same by number of joints.
    origins : tuple of TrialOrigin
        Whether the trials were simulated or measured.
    """

    signals: dict[str, SignalError]
    trials: int
    dof: dict[str, DofEvaluation] = {}
    origins: tuple[TrialOrigin, ...]


class FloorRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Noise floor of one number of joints; every spectrum is a string of numbers.

    Attributes
    ----------
    frequency_hz : str
        Frequencies of `noise` and `model`.
    repeats : float
        Trials that went into each mean curve.
    noise, model : dict of str to str
        Variance of a coefficient by signal.
    curves : dict
        Mean error: group of trials → payload in kg → signal → spectrum.
    rest_s : dict of str to float
        Rest before the motion by group of trials; the rig's where it is left out.
    payload_ratio_hz : str
        Frequencies of `noise_ratio` and `model_ratio`.
    noise_ratio, model_ratio : dict
        Variance at one payload over its mean: payload in kg → signal → ratios.
    """

    frequency_hz: str
    repeats: float
    noise: dict[str, str]
    model: dict[str, str]
    curves: dict[str, dict[str, dict[str, str]]]
    rest_s: dict[str, float]
    payload_ratio_hz: str
    noise_ratio: dict[str, dict[str, str]]
    model_ratio: dict[str, dict[str, str]]


class FittedTrial(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Trial that a value of the plant was fitted to.

    Attributes
    ----------
    name : str
        For people; trials of different directories may have the same name.
    sha256 : str
        Hash of conditions and samples (`models.trials.trial.Trial.sha256`).
    source, rig : str
        Its origin (`models.trials.trial_origin`); no rig where it was measured.
    pressure_pa : float
        Pressure of the link; 0 of other plants.
    """

    name: str
    sha256: str
    source: str
    rig: str = ""
    pressure_pa: float = 0.0


class Provenance(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True
):
    """Origin of a plant's values.

    Attributes
    ----------
    parent_sha256 : str
        Hash of the plant document that the fit started from; empty for a nominal plant.
    data_sha256 : str
        Hash of the set of trials of the last fit, held-out ones included.
    fitted_trials : tuple of FittedTrial
        Trials of the last fit and of all fits before it.
    held_out_trials : tuple of str
        Names of the trials of the last `identify` that were not fitted.
    fitted_parameters : tuple of str
        Parameters of the last `identify`.
    residual_rms : dict of str to float
        Residual of the last `identify` by signal, in the signal's unit.
    held_out : Evaluation or None
        Errors on the held-out trials, or on the fitted ones where none were held out.
    named : tuple of str
        Effects that `gap` added or changed.
    noise_floor : dict of str to FloorRecord
        By number of joints.
    servo_gains : tuple of ServoGains
        Gains that the servos had in the fitted trials, by joint; empty where nobody said.
    """

    parent_sha256: str = ""
    data_sha256: str = ""
    fitted_trials: tuple[FittedTrial, ...] = ()
    held_out_trials: tuple[str, ...] = ()
    fitted_parameters: tuple[str, ...] = ()
    residual_rms: dict[str, float] = {}
    held_out: Evaluation | None = None
    named: tuple[str, ...] = ()
    noise_floor: dict[str, FloorRecord] = {}
    servo_gains: tuple[ServoGains, ...] = ()

    def fitted_with(self, trials: Iterable[Trial]) -> tuple[FittedTrial, ...]:
        """Fitted trials of this plant and, after them, those of `trials` that are not among them.

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
        """Whether a trial with these conditions and samples was fitted, under any name."""
        return trial.sha256() in {t.sha256 for t in self.fitted_trials}


def read_provenance(where: Path | str, table: object) -> Provenance:
    """Provenance from the decoded table of a plant document.

    Parameters
    ----------
    where : Path or str
        Plant document, for the message.
    table : object
        Its `provenance`, as JSON or TOML decodes it.

    Raises
    ------
    InputError
        If the table does not have this form.
    """
    return convert(table, Provenance, where, "provenance does not fit its form", _WRITE_AGAIN)
