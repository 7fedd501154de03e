"""Plant document: the content of a plant file, TOML or JSON.

People write TOML; `identify` and `gap` write JSON of the same form::

    schema = 1
    name = "drop-stitch link"
    drive = { kind = "cascade" }        # models.plant.components.DRIVES
    load = { kind = "link" }            # models.plant.components.LOADS
    effects = [{ name = "coulomb_friction" }, …]
    [signals.angle_1_rad]               # only for a plant that is not the link
    unit = "rad"
    role = "measured"
    [parameters]                        # what differs from the parts; identify writes all of them
    base_mass_kg = 0.3
    link_mass_kg = { value = 0.9, unit = "kg", bounds = [0.3, 3.0], source = "weighed" }

Its `provenance` table tells the plant's parent, its data, and every trial that it was fitted to.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, ClassVar, Final

import msgspec
import tomli_w

from firmware_py.bus.servo_models import ServoGains
from firmware_py.core.documents import Document, check_version
from firmware_py.core.errors import InputError
from firmware_py.core.input_files import convert, read_json, read_toml
from firmware_py.core.output_files import write_whole
from firmware_py.core.units import LENGTH
from firmware_py.link.link_description import (
    STUDY_LINK,
    LinkDescription,
    check_link,
    describes_link,
    read_link,
)
from models.plant.parameter import Parameter, Role
from models.trials.origin import TrialOrigin, merged_origins, recorded_rig
from models.trials.trial import SignalRole, Trial
from models.trials.units import check_signal_units, other_unit

CLOCK_LIMIT_S: Final = 0.010
"""Largest offset of a trial's clock that is refitted: beyond it a recording counts as not
synchronised [assumed]."""


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
    # The same as `tip_rms_m` with the clock of each trial's motion capture refitted
    clock_tip_rms_m: float | None = None


class DofEvaluation(TipError, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Errors of a plant on the trials with one number of joints."""

    signals: dict[str, SignalError]
    trials: int  # Number of trials
    payloads: dict[str, TipError] = {}  # Errors by payload in kg


class Evaluation(TipError, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Errors of a plant on trials; `evaluate_plant` measures them.

    Examples
    --------
    >>> result = Evaluation(signals={"di": SignalError(1e-3, 2e-3, "1")}, trials=1, origins=())
    >>> result
    <Evaluation on 1 trial: di 0.001 RMS>
    """

    signals: dict[str, SignalError]
    trials: int  # Number of trials
    dof: dict[str, DofEvaluation] = {}  # Errors by number of joints
    origins: tuple[TrialOrigin, ...]  # Whether the trials were simulated or measured
    # Refitted delay of the motion capture behind the servos in s, by trial; at most 10 ms
    clocks_s: dict[str, float] = {}

    def __repr__(self) -> str:
        trials = f"{self.trials} trial{'' if self.trials == 1 else 's'}"
        if self.tip_rms_m is None:
            errors = ", ".join(
                f"{name} {row.rms:.3g} {row.unit if row.unit != '1' else ''}".strip() + " RMS"
                for name, row in self.signals.items()
            )
            return f"<Evaluation on {trials}: {errors}>"
        rigid = ""
        if self.rigid_tip_rms_m is not None:
            rigid = f", of a rigid link {LENGTH.number(self.rigid_tip_rms_m)} mm"
        return f"<Evaluation on {trials}: tip error {LENGTH.number(self.tip_rms_m)} mm RMS{rigid}>"

    def _repr_html_(self) -> str:
        from models.shared.notebook import html_table

        rows = [(n, f"{e.rms:.4g}", f"{e.mae:.4g}", e.unit) for n, e in self.signals.items()]
        return html_table(repr(self)[1:-1], ("signal", "RMS", "mean |error|", "unit"), rows)

    def summary(self) -> str:
        """Return tables of the errors: signals in SI units, end effector in mm."""
        lines = [f"{'signal':14s}{'rms':>12s}{'mean |error|':>14s}  unit"]
        lines += [
            f"{name:14s}{row.rms:12.4g}{row.mae:14.4g}  {row.unit}"
            for name, row in self.signals.items()
        ]
        if self.tip_rms_m is not None:
            titles = ("plant, mm", "clock refitted", "rigid, mm")
            lines += ["", f"{'end effector':14s}" + "".join(f"{title:>16s}" for title in titles)]
            for dof, part in self.dof.items():
                rows = {f"{load} kg": row for load, row in part.payloads.items()} | {"all": part}
                for label, row in rows.items():
                    errors_m = (row.tip_rms_m, row.clock_tip_rms_m, row.rigid_tip_rms_m)
                    texts = ("" if m is None else LENGTH.number(m, 2) for m in errors_m)
                    lines.append(f"{dof}DOF {label:9s}" + "".join(f"{text:>16s}" for text in texts))
            lines += ["", self.clock_sentence()]
        return "\n".join(lines)

    def clock_sentence(self) -> str:
        """Say which part of the tip's error is the plant's, and which that of the clocks."""
        whole_m, plant_m = self.tip_rms_m or 0.0, self.clock_tip_rms_m or 0.0
        clock_m = math.sqrt(max(whole_m**2 - plant_m**2, 0.0))
        clocks_ms = [1e3 * clock_s for clock_s in self.clocks_s.values()]
        text = (
            f"of {LENGTH.text(whole_m)} RMS, {LENGTH.text(clock_m)} is the motion capture's clock "
            f"({min(clocks_ms):.1f} to {max(clocks_ms):.1f} ms from trial to trial); with each "
            f"trial's clock refitted {LENGTH.text(plant_m)}"
        )
        common_ms = sum(clocks_ms) / len(clocks_ms)
        if abs(common_ms) > 0.5:  # A good plant has less [assumed].
            text += (
                f"; all trials share {common_ms:.1f} ms, which may be a delay that the plant lacks"
            )
        limit_s = (1 - 1e-3) * CLOCK_LIMIT_S
        at_limit = [name for name, clock_s in self.clocks_s.items() if abs(clock_s) > limit_s]
        if at_limit:
            limit = f"at the limit of {1e3 * CLOCK_LIMIT_S:g} ms, so the clock may be off by more"
            text += f"; {limit}: " + ", ".join(at_limit)
        return text


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


class PartKind(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Drive or load of a plant, by its kind."""

    kind: str


class EffectEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Effect of a plant, by its name in the catalogue."""

    name: str


class ParameterEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Value of a parameter; a missing key keeps the default of the drive, load or effect."""

    value: float
    unit: str | None = None  # SI unit in the spelling of FMI, "1" if dimensionless
    bounds: tuple[float, float] | None = None  # Lowest and highest possible value
    role: Role | None = None
    source: str | None = None  # Where value and bounds come from
    error: float | None = None  # Standard error of an identified value
    prior_deviation: float | None = None  # Standard deviation of the value before a fit


class PlantDocument(Document, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Plant: drive, load, effects and parameters."""

    MADE_BY: ClassVar[str] = "dropstitch identify"

    name: str
    drive: PartKind
    load: PartKind
    effects: list[EffectEntry] = msgspec.field(default_factory=list)
    # Columns and conditions of the plant's trials; empty for the link
    signals: dict[str, SignalRole] = msgspec.field(default_factory=dict)
    # Parameters of drive, load and effects, also of effects that the plant does not have yet
    parameters: dict[str, float | ParameterEntry] = msgspec.field(default_factory=dict)
    provenance: Provenance = msgspec.field(default_factory=Provenance)  # Where the values come from
    link: LinkDescription | None = None  # Link that the plant models; null for the study's


def read_plant_document(path: Path) -> PlantDocument:
    """Read a plant file; JSON or TOML by the suffix."""
    remedy = "name a plant, e.g. models/plant/nominal.toml"
    raw = read_json(path, remedy) if path.suffix.lower() == ".json" else read_toml(path, remedy)
    table = raw.pop("provenance", {}) if isinstance(raw, dict) else {}
    check_version(path, raw, PlantDocument.VERSION, f"write it anew with {PlantDocument.MADE_BY}")
    document = convert(raw, PlantDocument, path, "is no plant document", "correct it")
    for name, count in Counter(effect.name for effect in document.effects).items():
        if count > 1:
            raise InputError(path, f"effect {name} stands twice", "remove one")
    for name, value in document.parameters.items():
        _check_entry(path, name, value)
    check_signal_units(path, document.signals)
    if document.link is not None:
        check_link(document.link, path)
    provenance = convert(
        table, Provenance, path, "provenance does not fit its form",
        "write the plant again with 'dropstitch identify' or 'dropstitch gap'",
    )  # fmt: skip
    return msgspec.structs.replace(document, provenance=provenance)


def _check_entry(path: Path, name: str, value: float | ParameterEntry) -> None:
    """Refuse invalid numbers; `check_values` compares the value with its bounds later."""
    entry = _entry(value)
    if not math.isfinite(entry.value):
        raise InputError(path, f"parameter {name} is not a finite number", "correct it")
    low, high = entry.bounds or (0.0, 0.0)
    if not (math.isfinite(low) and math.isfinite(high)):
        what = f"bounds of parameter {name} are {low:g} and {high:g}, not finite numbers"
        raise InputError(path, what, "correct them")
    if low > high:
        what = f"bounds of parameter {name} are [{low:g}, {high:g}], the larger one first"
        raise InputError(path, what, "swap them")
    for key in ("prior_deviation", "error"):
        spread = getattr(entry, key)
        if spread is not None and not 0.0 <= spread < math.inf:
            what = f"{key} of parameter {name} is {spread:g}"
            raise InputError(path, what, "give a number above 0, or leave it out")


def _entry(value: float | ParameterEntry) -> ParameterEntry:
    return value if isinstance(value, ParameterEntry) else ParameterEntry(value=value)


def merged_parameter(where: Path | str, q: Parameter, value: float | ParameterEntry) -> Parameter:
    """Declared parameter, updated by its entry in a plant file."""
    entry = _entry(value)
    if entry.unit not in (None, q.unit):
        raise InputError(
            where, f"parameter {q.name} is given in {entry.unit!r}", f"convert it to {q.unit!r}"
        )
    low, high = entry.bounds or (q.low, q.high)
    return msgspec.structs.replace(
        q, value=entry.value, low=low, high=high, error=entry.error, role=entry.role or q.role,
        source=q.source if entry.source is None else entry.source,
        prior_deviation=entry.prior_deviation or q.prior_deviation,
    )  # fmt: skip


def check_condition_units(
    where: Path, signals: Mapping[str, SignalRole], parameters: Mapping[str, Parameter]
) -> None:
    """Refuse a condition in another unit than the parameter that it replaces."""
    for name, signal in signals.items():
        q = parameters.get(signal.quantity or name)
        if signal.role == "condition" and q is not None and signal.unit != q.unit:
            raise other_unit(where, name, signal, f"parameter {q.name} in {q.unit!r}", q.unit)


def link_of_plant(path: Path) -> LinkDescription:
    """Link of a plant's or a link's file; the study's link if a plant's file describes none."""
    if path.suffix.lower() == ".toml" and describes_link(read_toml(path, "name a plant or a link")):
        return read_link(path)
    return read_plant_document(path).link or STUDY_LINK


def write_plant_document(document: PlantDocument, path: Path) -> None:
    """Write a plant file in one step, JSON or TOML by the suffix; create its directory."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix.lower() == ".json":
        text = plant_json(document) + "\n"
    else:
        text = tomli_w.dumps(_without_none(plain_plant(document)))
    write_whole(path, text.encode())


def plant_json(document: PlantDocument) -> str:
    return json.dumps(plain_plant(document), indent=1)


def plain_plant(document: PlantDocument) -> dict[str, Any]:
    """Document as dictionaries and lists; without the link if there is none."""
    plain: dict[str, Any] = msgspec.to_builtins(document)
    link = plain.pop("link")
    return plain if link is None else plain | {"link": _without_none(link)}


def _without_none(value: Any) -> Any:
    """Plain document without null values, which TOML cannot express."""
    if isinstance(value, dict):
        return {k: _without_none(v) for k, v in value.items() if v is not None}
    return [_without_none(v) for v in value] if isinstance(value, list | tuple) else value
