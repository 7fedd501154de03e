"""Noise floor of a plant: the residual that it leaves on trials without a hidden effect.

`identify` measures it on its own trials and stores it in the plant file; the gap workflow counts
only what rises above it. Repetitions of a trial separate two parts of the variance of a residual:
`noise` is drawn anew in every trial, `model` is the plant's own error, which repeats. What merely
varies between trials (pressure, friction, clock, place of the payload, frame of the motion capture)
is fitted first, within its prior. It cannot be fitted without a floor, nor the floor be measured
without it, so both are repeated a few times.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct
from scipy.optimize import least_squares

from firmware_py.errors import InputError
from models.plant.document import FloorRecord
from models.plant.identification.evaluation import TIP
from models.plant.identification.fit import (
    LARGEST_DERIVATIVE,
    WORKERS,
    measured_signals,
    row_weights,
    shortened,
    usual_error,
)
from models.plant.plant import Plant
from models.plant.simulation.runner import CompiledModel, differentiate_trial, trial_parameters
from models.plant.step_model import names
from models.trials.trial import Trial, TrialSet, motion_start

Array = NDArray[np.float64]

PayloadSpectra = Mapping[float, Mapping[str, Array]]
"""Spectra by payload in kg and signal."""


class FloorSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Tuned numbers of the noise floor. Variations are standard deviations between repetitions."""

    highest_frequency_hz: float = 8.0
    """Highest frequency of the spectra; the first mode lies at 1.4 to 3.5 Hz
    (docs/sources.md, "The link")."""
    longest_substep_s: float = 2.9e-3
    """Longest internal step of the link's simulation: what a dead time of zero allows
    (`models.plant.effects.command`). Measured: six a period are within 5 µm and 0.5 mA of a step of
    0.25 ms; 46 µm with ten times the usual friction. Other loads keep the step of their model: the
    bristles of a small gear are faster."""
    not_followed_error_rad: float = 0.03
    """Following error, beyond the largest of the twin, above which a goal counts as not followed
    [assumed]."""
    not_followed_current_fraction: float = 0.95
    """Fraction of a trial's largest current that the joint must draw while it does not follow
    [assumed]."""
    pressure_variation_fraction: float = 0.01
    """Standard deviation of stiffness between repetitions of a trial [assumed]."""
    friction_variation_fraction: float = 0.05
    """Standard deviation of friction between repetitions [assumed]."""
    eccentricity_variation_m: float = 0.003
    """Standard deviation of the payload's eccentricity between repetitions [assumed]."""
    clock_variation_s: float = 0.002
    """Standard deviation of the clock between repetitions [assumed]."""
    frame_variation_m: float = 0.0003
    """Standard deviation of each coordinate of the mocap frame between repetitions [assumed]."""
    noise_floor_rounds: int = 3
    """Times that floor and trial variation are estimated in turn [assumed]."""
    floor_fit_steps: int = 12
    """Most steps of a fit while the noise floor is measured [assumed]."""
    samples_per_independent_sample: float = 12.0
    """Samples that count as one in the first guess of a floor
    (docs/sources.md, "Naming a missing effect")."""
    smoothing_fraction: float = 0.25
    """Half width of the smoothing of a spectrum, as a fraction of the frequency [assumed]."""
    smoothing_coefficients: int = 4
    """Least half width, in coefficients [assumed]."""
    payload_reach_kg: float = 1.0
    """Difference in payload over which the plant's own error changes [assumed]."""
    least_noise_fraction: float = 1e-9
    """Least noise, as a fraction of a signal's largest variance: keeps matrices regular
    [assumed]."""


DEFAULT_FLOOR_SETTINGS: Final = FloorSettings()


def with_noise_floor(
    plant: Plant, trials: Iterable[Trial], settings: FloorSettings = DEFAULT_FLOOR_SETTINGS
) -> Plant:
    """Plant whose provenance also holds the noise floor of trials without any hidden effect.

    Repetitions separate noise from the plant's own error; without any there is no floor. Trials of
    one and of two joints have a floor each.
    """
    floors: dict[str, FloorRecord] = {}
    trials = aligned(TrialSet(tuple(trials)))
    for dof in sorted({t.meta.dof for t in trials}):
        own = [t for t in trials if t.meta.dof == dof]
        conditions = {(trial_group_key(t), t.meta.payload_kg) for t in own}
        if len(conditions) < len(own):
            floors[str(dof)] = floor_to_record(measure_noise_floor(plant, own, settings))
    return replace(plant, provenance=msgspec.structs.replace(plant.provenance, noise_floor=floors))


def measure_noise_floor(
    plant: Plant, trials: Sequence[Trial], settings: FloorSettings = DEFAULT_FLOOR_SETTINGS
) -> MeasuredFloor:
    """Floor of trials with one number of joints."""
    twin = _VariedTwin(plant, trials, settings)
    floor = guessed_floor(twin.groups, twin.trials, twin.units, settings)
    values = np.zeros(twin.size)
    for _ in range(settings.noise_floor_rounds):
        values = twin.fit(floor, values)
        floor = floor_from_residuals(twin.groups, twin.trials, twin.spectra(values), settings)
    return floor


# Spectra: a cosine transform in which a stationary error is nearly uncorrelated. The orthonormal
# DCT-II of a trial of n samples has coefficients at k / (2 n h); those up to
# `FloorSettings.highest_frequency_hz` are used. The variance of a coefficient is the noise's
# spectrum at its frequency, which accounts for autocorrelation: a slow error fills few
# coefficients, so it counts as few samples.


def coefficient_count(samples: int, step_s: float, highest_hz: float) -> int:
    """Number of coefficients of a trial that are used."""
    return min(samples, max(4, int(2 * samples * step_s * highest_hz)))


def coefficient_frequencies_hz(coefficients: int, samples: int, step_s: float) -> Array:
    """Frequencies of the first coefficients of a trial, shape (K,)."""
    return np.arange(coefficients) / (2 * samples * step_s)


def cosine_transform(rows: Array, coefficients: int) -> Array:
    """First coefficients (K, ...) of rows (n, ...)."""
    return np.asarray(dct(rows, type=2, norm="ortho", axis=0)[:coefficients])


def inverse_cosine_transform(coefficients: Array, samples: int) -> Array:
    """Rows (n, ...) of coefficients (K, ...)."""
    return np.asarray(idct(coefficients, type=2, norm="ortho", axis=0, n=samples))


def smoothed_power(power: Array, width_fraction: float, least_coefficients: int) -> Array:
    """Mean of power over neighbouring coefficients.

    `width_fraction`: half width of the window, as a fraction of the frequency. Shapes: `power`
    (..., K).
    """
    count = power.shape[-1]
    total = np.concatenate([np.zeros((*power.shape[:-1], 1)), np.cumsum(power, axis=-1)], axis=-1)
    half = np.maximum(least_coefficients, (width_fraction * np.arange(count)).astype(int))
    low = np.maximum(np.arange(count) - half, 0)
    high = np.minimum(np.arange(count) + half + 1, count)
    return np.asarray((total[..., high] - total[..., low]) / (high - low))


# Groups of trials of one motion


MOST_CUT: Final = 0.1
"""Largest part of a motion that is cut off to match a shorter trial of it [assumed]."""

LEAST_COEFFICIENTS: Final = 12
"""Fewest coefficients of a trial: three bands of four [assumed]."""


@dataclass(frozen=True)
class TrialGroup:
    """Trials of one motion, whose spectra can be compared coefficient by coefficient."""

    key: str  # See `trial_group_key`
    trials: tuple[int, ...]
    signals: tuple[str, ...]  # Signals that both simulation and measurement have
    coefficients: int  # Number of coefficients that are used


def trial_group_key(trial: Trial) -> str:
    """Key of a trial's conditions apart from payload and repetition."""
    m = trial.meta
    conditions = "".join(f" {name}={value:.5g}" for name, value in sorted(m.conditions.items()))
    return (
        f"{m.dof}dof {m.motion} {m.amplitude_rad:.5g}rad {m.period_s:.5g}s {m.phase_2_rad:.4g}rad "
        f"{len(trial)}x{trial.step_s:.5g}s{conditions}"
    )


def check_duration(trial: Trial, settings: FloorSettings = DEFAULT_FLOOR_SETTINGS) -> None:
    """Refuse a trial that is too short to have a spectrum."""
    hz = settings.highest_frequency_hz
    if coefficient_count(len(trial), trial.step_s, hz) < LEAST_COEFFICIENTS:
        raise InputError(
            trial.path if trial.path.name else trial.name,
            f"lasts {len(trial) * trial.step_s:.2g} s",
            f"give at least {LEAST_COEFFICIENTS / (2 * hz):.2g} s of motion",
        )


def aligned(trials: TrialSet) -> TrialSet:
    """Trials whose rest is that of their goals; those of one motion get equal rests and ends.

    Trials are not cut to match one that is shorter by more than `MOST_CUT`.
    """
    starts = [motion_start(t) for t in trials]
    motions: dict[str, list[int]] = defaultdict(list)
    for k, trial in enumerate(trials):
        motions[trial_group_key(_rows(trial, 0, slice(2)))].append(k)  # whatever its length
    result = list(trials)
    for own in motions.values():
        rest, common = min(starts[k] for k in own), 0
        moving = {k: len(result[k]) - starts[k] for k in own}
        for k in sorted(own, key=moving.__getitem__):
            if moving[k] * (1 - MOST_CUT) > common:
                common = moving[k]
            first = starts[k] - rest
            result[k] = _rows(result[k], rest, slice(first, first + rest + common))
    return TrialSet(tuple(result))


def _rows(trial: Trial, rest: int, kept: slice) -> Trial:
    """Rows `kept` of a trial, with `rest` rows before the start of its motion."""
    meta = msgspec.structs.replace(trial.meta, rest_samples=rest)
    columns = {name: column[kept] for name, column in trial.columns.items()}
    return replace(trial, meta=meta, columns=columns)


def trial_groups(
    trials: Sequence[Trial], outputs: Sequence[str], settings: FloorSettings
) -> list[TrialGroup]:
    """Groups of the trials, with the signals that were measured and are simulated."""
    members: dict[tuple[str, tuple[str, ...]], list[int]] = {}
    for k, trial in enumerate(trials):
        measured = measured_signals(trial)
        signals = tuple(s for s in outputs if s in measured and np.isfinite(measured[s]).any())
        if not signals:
            raise InputError(
                trial.path, "has no measured signal that the plant simulates",
                "declare one of " + ", ".join(outputs) + " and give its samples",
            )  # fmt: skip
        check_duration(trial, settings)
        members.setdefault((trial_group_key(trial), signals), []).append(k)
    return [
        TrialGroup(key, tuple(rows), signals, coefficient_count(
            len(trials[rows[0]]), trials[rows[0]].step_s, settings.highest_frequency_hz
        ))
        for (key, signals), rows in members.items()
    ]  # fmt: skip


def group_frequencies_hz(group: TrialGroup, trials: Sequence[Trial]) -> Array:
    """Frequencies of the coefficients of a group, shape (K,)."""
    first = trials[group.trials[0]]
    return coefficient_frequencies_hz(group.coefficients, len(first), first.step_s)


def rows_that_follow(
    trial: Trial, usual_error_rad: Array, settings: FloorSettings = DEFAULT_FLOOR_SETTINGS
) -> Array:
    """1 for each row before a joint stops following its goal, 0 after, shape (n,).

    There the current saturates and the joint falls behind. Two such falls differ, so no simulation
    reproduces them. Where angle or current were not measured, every row counts.

    Shapes: `usual_error_rad` (joints,).
    """
    joints = range(1, trial.meta.dof + 1)
    needed = {q.format(j) for q in ("goal_{}_rad", "angle_{}_rad", "current_{}_a") for j in joints}
    if not trial.columns.keys() >= needed:
        return np.ones(len(trial))
    error, current = np.abs(trial.goal_rad - trial.angle_rad), np.abs(trial.current_a)
    behind = error > usual_error_rad + settings.not_followed_error_rad
    saturated = current > settings.not_followed_current_fraction * current.max(axis=0)
    not_followed = np.any(behind & saturated, axis=1)
    return np.asarray(np.cumsum(not_followed) == 0, dtype=np.float64)


def interpolate_missing(rows: Array) -> Array:
    """Rows with missing values interpolated; zero if all are missing."""
    measured = np.isfinite(rows)
    if measured.all():
        return rows
    if not measured.any():
        return np.zeros(len(rows))
    place = np.arange(len(rows))
    return np.interp(place, place[measured], rows[measured])


def signal_spectrum(
    trial: Trial, signal: str, rows: Array, follows: Array, coefficients: int
) -> Array:
    """Spectrum (K, ...) of rows (n, ...) of a signal, weighted as in a fit."""
    weight = follows * row_weights(trial, signal)
    return cosine_transform(weight.reshape(-1, *[1] * (rows.ndim - 1)) * rows, coefficients)


# Variation between trials


@dataclass(frozen=True)
class Variation:
    """What varies from one repetition of a trial to the next: a direction in the twin."""

    name: str
    parameters: Mapping[str, float]  # Change of each plant parameter per unit
    outputs: Mapping[str, float]  # Direct change of each output per unit
    standard_deviation: float


VARIED_EFFECTS: Final = ("payload_offset", "sync_offset")
"""Effects whose strength varies between trials of a link."""

SHARED: Final = "sync_s"
"""Variation whose mean over the trials is none: a clock error common to all trials is a property of
the set-up. The gap workflow fits it as `synchronisation`."""

KNOWN_FRACTION: Final = 0.01
"""Standard deviation of a mean that counts as known, over its standard deviation by chance
[assumed]: small enough to hold the mean, large enough to keep matrices regular."""


def trial_variation(
    plant: Plant, own: Iterable[str], trial: Trial, settings: FloorSettings
) -> list[Variation]:
    """Pressure, friction, payload, clock and frame of a trial; nothing for loads but the link.

    `plant` has `VARIED_EFFECTS`; `own` names the parameters that its twin has.
    """
    if plant.load != "link":
        return []
    q = {name: plant.parameters[name] for name in own}
    stiff = {n: p.value for n, p in q.items() if p.unit == "N.m/rad"}
    stiff |= {n: p.value for n, p in q.items() if n == "root_limit_moment_nm"}
    friction = {n: p.value for n, p in q.items() if "_friction_" in n}
    length_m = trial.meta.link_length_m or plant.parameters["link_length_m"].value
    off_centre = {"payload_offset_share": 1 / length_m}
    return [
        Variation("pressure", stiff, {}, settings.pressure_variation_fraction),
        Variation("friction", friction, {}, settings.friction_variation_fraction),
        Variation("eccentricity_m", off_centre, {}, settings.eccentricity_variation_m),
        Variation(SHARED, {"sync_offset_s": 1.0}, {}, settings.clock_variation_s),
        *(Variation("frame_m", {}, {axis: 1.0}, settings.frame_variation_m) for axis in TIP),
    ]


FIT_TOLERANCE: Final = 1e-4
"""Relative fall of the cost below which the fit of the variation ends [assumed]."""


class _VariedTwin:
    """Residual spectra of trials, as a function of the variation of each trial."""

    def __init__(self, plant: Plant, trials: Sequence[Trial], settings: FloorSettings) -> None:
        is_link = plant.load == "link"
        varied = plant.with_effects(*VARIED_EFFECTS) if is_link else plant
        model = varied.step_model(trials[0].meta.dof, "twin")
        if is_link:
            model = model.with_substeps(settings.longest_substep_s)
        self.plant, self.settings = plant, settings
        self.trials = shortened(trials, model)
        self.units = {v.name: v.unit for v in model.outputs}
        self.groups = trial_groups(self.trials, list(self.units), settings)
        known = names(model.parameters)
        self._variation = [trial_variation(varied, known, t, settings) for t in self.trials]
        every = [v for own in self._variation for v in own]
        self._moved = list(dict.fromkeys(name for v in every for name in v.parameters))
        self._columns = [known.index(name) for name in self._moved]
        self._shared = np.array([v.name == SHARED for v in every])
        self._deviation = np.array([v.standard_deviation for v in every])
        self.size = len(every)
        self._model = CompiledModel(model, self._moved)
        self._measured = [measured_signals(t) for t in self.trials]
        self._last: tuple[bytes | None, list[tuple[Array, Array]]] = (None, [])
        self._follows = [np.ones(len(t)) for t in self.trials]
        if is_link:
            angles = [
                list(self.units).index(f"angle_{j + 1}_rad") for j in range(trials[0].meta.dof)
            ]
            for k, (y, _) in enumerate(self._runs(np.zeros(self.size))):
                trial = self.trials[k]
                error_rad = np.abs(trial.goal_rad - y[:, angles]).max(axis=0)
                self._follows[k] = rows_that_follow(trial, error_rad, settings)

    def _runs(self, values: Array) -> list[tuple[Array, Array]]:
        """Outputs (n, outputs) of each trial, and their derivatives (n, outputs, variations)."""
        if values.tobytes() != self._last[0]:
            by_trial = values.reshape(len(self.trials), -1)
            with ThreadPoolExecutor(WORKERS) as pool:
                runs = list(pool.map(self._run, range(len(self.trials)), by_trial))
            self._last = (values.tobytes(), runs)
        return self._last[1]

    def _run(self, k: int, values: Array) -> tuple[Array, Array]:
        own, model = self._variation[k], self._model.model
        parameters = np.zeros((len(self._moved), len(own)))
        outputs = np.zeros((len(self.units), len(own)))
        for column, variation in enumerate(own):
            for name, change in variation.parameters.items():
                parameters[self._moved.index(name), column] = change
            for name, change in variation.outputs.items():
                outputs[list(self.units).index(name), column] = change
        p = trial_parameters(model, self.trials[k])
        p[self._columns] += parameters @ values
        p = np.clip(p, [v.minimum for v in model.parameters], [v.maximum for v in model.parameters])
        y, slopes = differentiate_trial(self._model, self.trials[k], p)
        with np.errstate(over="ignore", invalid="ignore"):  # an unstable simulation
            return y + outputs @ values, slopes @ parameters + outputs

    def spectra(self, values: Array) -> list[Array]:
        """Measured minus simulated, a spectrum (trials, signals, K) for each group."""
        rows = []
        for measured, (y, _) in zip(self._measured, self._runs(values), strict=True):
            missing = np.full(len(y), np.nan)
            residual = np.column_stack([measured.get(s, missing) for s in self.units]) - y
            if np.isfinite(y).all():
                residual = np.column_stack([interpolate_missing(column) for column in residual.T])
            rows.append(residual)
        return self._transformed(rows)

    def _transformed(self, rows: Sequence[Array]) -> list[Array]:
        """Spectra (trials, signals, K, ...) for each group, of rows (n, outputs, ...) by trial."""
        place = {signal: k for k, signal in enumerate(self.units)}
        return [
            np.array([
                [
                    signal_spectrum(
                        self.trials[k], signal, rows[k][:, place[signal]], self._follows[k],
                        group.coefficients,
                    )
                    for signal in group.signals
                ]
                for k in group.trials
            ])
            for group in self.groups
        ]  # fmt: skip

    def fit(self, floor: MeasuredFloor, start: Array) -> Array:
        """Variation of all trials with the least cost in units of a floor, priors included."""
        if not self.size:
            return start
        whiteners = [_whitener(floor, g, self.trials, self.settings) for g in self.groups]
        count = len(self.trials)
        mean_deviation = KNOWN_FRACTION * self._deviation[self._shared][0] / np.sqrt(count)
        prior = np.vstack([np.diag(1 / self._deviation), self._shared / count / mean_deviation])

        def residual(values: Array) -> Array:
            white = [
                np.einsum("skij,jsk->isk", w, r).ravel()
                for w, r in zip(whiteners, self.spectra(values), strict=True)
            ]
            return np.concatenate([*white, prior @ values])

        def jacobian(values: Array) -> Array:
            slopes = self._transformed([-slope for _, slope in self._runs(values)])
            parts = []
            for group, w, d in zip(self.groups, whiteners, slopes, strict=True):
                d[~(np.abs(d) < LARGEST_DERIVATIVE)] = 0.0
                white = np.einsum("skij,jskv->iskjv", w, d)
                rows = np.zeros((white[..., 0, 0].size, count, d.shape[-1]))
                rows[:, list(group.trials)] = white.reshape(len(rows), len(group.trials), -1)
                parts.append(rows.reshape(len(rows), -1))
            return np.concatenate([*parts, prior])

        if not np.isfinite(residual(start)).all():
            runs = zip(self.trials, self._runs(start), strict=True)
            unstable = [str(trial.path) for trial, (y, _) in runs if not np.isfinite(y).all()]
            raise InputError(
                f"plant {self.plant.name!r}",
                "does not stay finite on " + (", ".join(unstable) or "these trials"),
                "identify it on trials of this robot, or check the conditions of the trials",
            )
        solution = least_squares(
            residual, start, jacobian, x_scale=self._deviation, ftol=FIT_TOLERANCE,
            max_nfev=self.settings.floor_fit_steps, tr_solver="lsmr",
        )  # fmt: skip
        return np.asarray(solution.x)


# The floor


@dataclass(frozen=True)
class MeasuredFloor:
    """Spectra of the noise floor, as a plant file carries them."""

    frequency_hz: Array  # (F,)
    # (F,), variance of a coefficient by signal: noise, and the plant's own error
    noise: Mapping[str, Array]
    model: Mapping[str, Array]
    # Mean error by motion and payload: group key → payload in kg → signal → (K,)
    curves: Mapping[str, PayloadSpectra] = field(default_factory=dict)
    repeats: float = 1.0  # Trials that went into each mean curve
    # Rest before the motion by group key of `curves`; the rig's if not listed
    rest_s: Mapping[str, float] = field(default_factory=dict)
    # Ratios of noise and model at each payload to their means
    ratios: PayloadRatios = field(default_factory=lambda: NO_RATIOS)

    def by_trial(
        self, signal: str, payloads_kg: Array, hz: Array, settings: FloorSettings
    ) -> tuple[Array, Array]:
        """Noise and model of trials with these payloads, shape (trials, K)."""
        noise, model = (
            np.interp(hz, self.frequency_hz, table[signal]) for table in (self.noise, self.model)
        )
        largest = float(max(np.max(noise), np.max(model)))
        least = settings.least_noise_fraction * max(largest, 1e-12)
        factors = [(self.amplification(p), p) for p in payloads_kg]
        noise_by = [f * noise * self.ratios.noise_at(signal, p, hz) for f, p in factors]
        model_by = [f * model * self.ratios.model_at(signal, p, hz) for f, p in factors]
        return np.maximum(noise_by, least), np.array(model_by)

    def amplification(self, payload_kg: float) -> float:
        """Factor on the power of noise and model at a payload."""
        return 1.0


def _whitener(
    floor: MeasuredFloor, group: TrialGroup, trials: Sequence[Trial], settings: FloorSettings
) -> Array:
    """Inverse Cholesky factors, shape (signals, K, trials, trials).

    The plant's own error is alike in trials i and j whose payloads are close::

        V_ij = noise_i δ_ij + √(model_i model_j) exp(−|payload_i − payload_j| / reach)
    """
    hz = group_frequencies_hz(group, trials)
    payloads_kg = np.array([trials[k].meta.payload_kg for k in group.trials])
    alike = np.exp(-np.abs(payloads_kg[:, None] - payloads_kg) / settings.payload_reach_kg)
    result = []
    for signal in group.signals:
        noise, model = floor.by_trial(signal, payloads_kg, hz, settings)
        size = np.sqrt(model).T
        variance = noise.T[:, :, None] * np.eye(len(payloads_kg))
        variance += size[:, :, None] * size[:, None, :] * alike
        result.append(np.linalg.inv(np.linalg.cholesky(variance)))
    return np.array(result)


def guessed_floor(
    groups: Sequence[TrialGroup],
    trials: Sequence[Trial],
    units: Mapping[str, str],
    settings: FloorSettings,
) -> MeasuredFloor:
    """Flat floor from the usual error of each signal, before any residual is known."""
    noise = {}
    for signal in dict.fromkeys(s for g in groups for s in g.signals):
        measured = [t.columns[signal] for t in trials if signal in t.columns]
        error = usual_error(units[signal], measured)
        noise[signal] = np.full(2, settings.samples_per_independent_sample * error**2)
    return MeasuredFloor(np.array([0.0, 1e3]), noise, {s: np.zeros(2) for s in noise})


def floor_from_residuals(
    groups: Sequence[TrialGroup],
    trials: Sequence[Trial],
    rows: Sequence[Array],
    settings: FloorSettings = DEFAULT_FLOOR_SETTINGS,
    repeated: bool = True,
) -> MeasuredFloor:
    """Floor from residuals of data without a gap.

    `repeated`: whether repetitions separate noise from the model's error; otherwise all is noise.
    Shapes: `rows` (trials, signals, K).
    """
    hz = max((group_frequencies_hz(g, trials) for g in groups), key=len)
    signals = list(dict.fromkeys(s for g in groups for s in g.signals))
    noise: dict[str, list[Array]] = {s: [] for s in signals}
    model: dict[str, list[Array]] = {s: [] for s in signals}
    curves: dict[str, dict[float, dict[str, Array]]] = {}
    rest_s: dict[str, float] = {}
    ratios = NO_RATIOS
    repeats = []
    for group, residual in zip(groups, rows, strict=True):
        own = group_frequencies_hz(group, trials)
        payloads = np.array([trials[k].meta.payload_kg for k in group.trials])
        by_payload = {float(p): residual[payloads == p] for p in np.unique(payloads)}
        parts = list(by_payload.values())
        within = [np.sum((p - p.mean(axis=0)) ** 2, axis=0) for p in parts if len(p) > 1]
        freedom = sum(len(p) - 1 for p in parts)
        split = repeated and freedom > 0
        for b, signal in enumerate(group.signals):
            if split:
                varying = smoothed(sum(w[b] for w in within) / freedom, settings)
            else:
                varying = smoothed(np.mean(residual[:, b] ** 2, axis=0), settings)
            mean_power = np.mean([p.mean(axis=0)[b] ** 2 for p in parts], axis=0)
            repeats.append(count := len(group.trials) / len(parts))
            standing = np.maximum(smoothed(mean_power, settings) - varying / count, 0.0)
            noise[signal].append(np.interp(hz, own, varying))
            model[signal].append(np.interp(hz, own, standing if split else 0 * varying))
        if split:
            if ratios is NO_RATIOS:
                ratios = payload_ratios(own, group.signals, by_payload)
            first = trials[group.trials[0]]
            rest_s.setdefault(group.key, first.meta.rest_samples * first.step_s)
            for p, part in by_payload.items():
                own_curves = curves.setdefault(group.key, {}).setdefault(p, {})
                for s, curve in zip(group.signals, part.mean(axis=0), strict=True):
                    own_curves.setdefault(s, curve)
    return MeasuredFloor(
        hz, averaged(noise), averaged(model), curves, float(np.mean(repeats)), rest_s, ratios
    )


def averaged(table: Mapping[str, Sequence[Array]]) -> dict[str, Array]:
    """Mean spectrum of each signal."""
    return {signal: np.mean(rows, axis=0) for signal, rows in table.items()}


def smoothed(power: Array, settings: FloorSettings) -> Array:
    """Power spectrum smoothed over neighbouring frequencies."""
    return smoothed_power(power, settings.smoothing_fraction, settings.smoothing_coefficients)


# Ratios of the floor at one payload to the floor over all payloads, by frequency. A heavy payload
# brings the link near its limit: below 2 Hz two trials of one motion differ there by ten to forty
# times the power of trials without payload, and the plant's own error grows alike. One floor for
# all payloads would hide a small effect in the trials without payload, and would take the scatter
# of the heaviest for an effect. Ratios are of power, smoothed over half the frequency to either
# side. Each is pooled with one coefficient of the common floor, because repetitions are few.


SMOOTHING_FRACTION: Final = 0.5
"""Half width of the smoothing, as a fraction of the frequency [assumed]."""

SMOOTHING_COEFFICIENTS: Final = 8
"""Least half width, in coefficients: seventeen coefficients are averaged [assumed]."""

COMMON_FRACTION: Final = 1 / (2 * SMOOTHING_COEFFICIENTS + 2)
"""Weight of the common floor beside those of a window: one coefficient."""

POINTS: Final = 12
"""Number of frequencies at which ratios are stored [assumed]."""


@dataclass(frozen=True)
class PayloadRatios:
    """Ratios of power by payload and signal, shape (POINTS,)."""

    frequency_hz: Array  # (POINTS,)
    noise: PayloadSpectra = field(default_factory=dict)  # Of the scatter between repetitions
    model: PayloadSpectra = field(default_factory=dict)  # Of the plant's own error

    def noise_at(self, signal: str, payload_kg: float, hz: Array) -> Array:
        """Ratio of the noise at a payload, shape (K,); ones if none is known."""
        return self._at(self.noise, signal, payload_kg, hz)

    def model_at(self, signal: str, payload_kg: float, hz: Array) -> Array:
        """Ratio of the plant's own error at a payload, shape (K,); ones if none is known."""
        return self._at(self.model, signal, payload_kg, hz)

    def _at(self, table: PayloadSpectra, signal: str, payload_kg: float, hz: Array) -> Array:
        """Logarithm interpolated in payload and frequency; constant beyond the ends."""
        known = sorted(p for p, own in table.items() if signal in own)
        if not known:
            return np.ones(len(hz))
        rows = np.log(np.array([table[p][signal] for p in known]))
        own = np.array([np.interp(payload_kg, known, column) for column in rows.T])
        return np.asarray(np.exp(np.interp(hz, self.frequency_hz, own)))


NO_RATIOS: Final[PayloadRatios] = PayloadRatios(np.zeros(1))


def payload_ratios(
    hz: Array, signals: Sequence[str], parts: Mapping[float, Array]
) -> PayloadRatios:
    """Ratios from residuals of repeated trials; none if a payload or a repetition is alone.

    Shapes: `hz` (K,), each of `parts` (repetitions, signals, K).
    """
    if len(parts) < 2 or any(len(rows) < 2 for rows in parts.values()):
        return NO_RATIOS
    at = ratio_frequencies_hz(hz)

    def ratios(smooth: Mapping[float, Array]) -> dict[float, dict[str, Array]]:
        common = np.maximum(np.mean(list(smooth.values()), axis=0), np.finfo(float).tiny)
        result: dict[float, dict[str, Array]] = {}
        for p, rows in smooth.items():
            ratio = (1 - COMMON_FRACTION) * rows / common + COMMON_FRACTION
            result[p] = {s: np.interp(at, hz, row) for s, row in zip(signals, ratio, strict=True)}
        return result

    within = {p: smooth_variance(rows) for p, rows in parts.items()}
    standing = {
        p: smoothed_power(np.mean(rows, axis=0) ** 2, SMOOTHING_FRACTION, SMOOTHING_COEFFICIENTS)
        for p, rows in parts.items()
    }
    return PayloadRatios(at, ratios(within), ratios(standing))


def ratio_frequencies_hz(hz: Array) -> Array:
    """Frequencies at which ratios are stored, shape (POINTS,)."""
    return np.geomspace(hz[1], hz[-1], POINTS)


def smooth_variance(repetitions: Array) -> Array:
    """Variance between repetitions of a trial, smoothed over frequency.

    Shapes: `repetitions` (R, signals, K).
    """
    variance = np.var(repetitions, axis=0, ddof=1)
    return smoothed_power(variance, SMOOTHING_FRACTION, SMOOTHING_COEFFICIENTS)


# The floor in the form that a plant file stores


def floor_to_record(floor: MeasuredFloor) -> FloorRecord:
    """Floor as stored in the plant file: a spectrum is one string of numbers."""

    def text(row: Array) -> str:
        return " ".join(f"{v:.4g}" for v in row)

    def by_signal(rows: Mapping[str, Array]) -> dict[str, str]:
        return {signal: text(row) for signal, row in rows.items()}

    def by_payload(table: PayloadSpectra) -> dict[str, dict[str, str]]:
        return {f"{payload_kg:g}": by_signal(rows) for payload_kg, rows in table.items()}

    return FloorRecord(
        frequency_hz=text(floor.frequency_hz),
        repeats=floor.repeats,
        noise=by_signal(floor.noise),
        model=by_signal(floor.model),
        curves={key: by_payload(table) for key, table in floor.curves.items()},
        rest_s=dict(floor.rest_s),
        payload_ratio_hz=text(floor.ratios.frequency_hz),
        noise_ratio=by_payload(floor.ratios.noise),
        model_ratio=by_payload(floor.ratios.model),
    )


def floor_from_record(record: FloorRecord) -> MeasuredFloor:
    """Floor that a plant file stores; ValueError if its lengths differ."""

    def row(text: str) -> Array:
        return np.array(text.split(), dtype=np.float64)

    def by_signal(rows: Mapping[str, str]) -> dict[str, Array]:
        return {signal: row(text) for signal, text in rows.items()}

    def by_payload(table: Mapping[str, Mapping[str, str]]) -> PayloadSpectra:
        return {float(payload_kg): by_signal(rows) for payload_kg, rows in table.items()}

    noise, model = by_signal(record.noise), by_signal(record.model)
    ratios = PayloadRatios(
        row(record.payload_ratio_hz), by_payload(record.noise_ratio), by_payload(record.model_ratio)
    )
    hz = row(record.frequency_hz)
    tables = [(noise, hz), (model, hz)]
    for of_payload in (ratios.noise, ratios.model):
        tables += [(dict(rows), ratios.frequency_hz) for rows in of_payload.values()]
    for rows, at in tables:
        for v in rows.values():
            if len(v) != len(at) or not np.all(np.isfinite(v)) or np.any(v < 0):
                raise ValueError(f"{len(v)} numbers for {len(at)} frequencies, or a negative one")
    if record.repeats < 1 or noise.keys() != model.keys():
        raise ValueError("repeats, or the signals of noise and model")
    curves = {key: by_payload(table) for key, table in record.curves.items()}
    return MeasuredFloor(hz, noise, model, curves, record.repeats, record.rest_s, ratios)
