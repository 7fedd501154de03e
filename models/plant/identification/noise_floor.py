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
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct
from scipy.optimize import least_squares

from firmware_py.core.errors import InputError
from models.plant.document import FloorRecord
from models.plant.identification.evaluation import TIP, nothing_measured
from models.plant.identification.fit import (
    CORRELATED_SAMPLES,
    LARGEST_DERIVATIVE,
    WORKERS,
    measured_signals,
    row_weights,
    shortened,
    usual_error,
    with_rows,
)
from models.plant.plant import Plant
from models.plant.simulation.runner import CompiledModel, differentiate_trial, trial_parameters
from models.plant.step_model import names
from models.trials.trial import Trial, TrialSet, motion_start

Array = NDArray[np.float64]

PayloadSpectra = Mapping[float, Mapping[str, Array]]
"""Spectra by payload in kg and signal."""

FLOOR_ROUNDS: Final = 3  # in which floor and variation are estimated in turn [assumed]


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
    twin = _VariedTwin(plant, trials)
    floor = guessed_floor(twin.groups, twin.trials, twin.units)
    values = np.zeros(twin.size)
    for _ in range(FLOOR_ROUNDS):
        values = twin.fit(floor, values)
        floor = floor_from_residuals(twin.groups, twin.trials, twin.spectra(values))
    return floor


# Spectra: a cosine transform in which a stationary error is nearly uncorrelated. The orthonormal
# DCT-II of a trial of n samples has coefficients at k / (2 n h); those up to `HIGHEST_HZ` are used.
# The variance of a coefficient is the noise's spectrum at its frequency, which accounts for
# autocorrelation: a slow error fills few coefficients, so it counts as few samples.

HIGHEST_HZ: Final = 8.0
"""Highest frequency of the spectra; the first mode lies at 1.4 to 3.5 Hz (docs/sources.md, "The
link")."""


def coefficient_count(samples: int, step_s: float) -> int:
    """Number of coefficients of a trial that are used."""
    return min(samples, max(4, int(2 * samples * step_s * HIGHEST_HZ)))


def coefficient_frequencies_hz(coefficients: int, samples: int, step_s: float) -> Array:
    """Frequencies of the first coefficients of a trial, shape (K,)."""
    return np.arange(coefficients) / (2 * samples * step_s)


def cosine_transform(rows: Array, coefficients: int) -> Array:
    """First coefficients (K, ...) of rows (n, ...)."""
    return np.asarray(dct(rows, type=2, norm="ortho", axis=0)[:coefficients])


def inverse_cosine_transform(coefficients: Array, samples: int) -> Array:
    """Rows (n, ...) of coefficients (K, ...)."""
    return np.asarray(idct(coefficients, type=2, norm="ortho", axis=0, n=samples))


def smoothed(power: Array, width_fraction: float = 0.25, least_coefficients: int = 4) -> Array:
    """Mean of power (..., K) over neighbouring coefficients.

    The half width of the window is a fraction of the frequency, at least some coefficients
    [assumed].
    """
    count = power.shape[-1]
    total = np.concatenate([np.zeros((*power.shape[:-1], 1)), np.cumsum(power, axis=-1)], axis=-1)
    half = np.maximum(least_coefficients, (width_fraction * np.arange(count)).astype(int))
    low = np.maximum(np.arange(count) - half, 0)
    high = np.minimum(np.arange(count) + half + 1, count)
    return np.asarray((total[..., high] - total[..., low]) / (high - low))


# Groups of trials of one motion

LEAST_COEFFICIENTS: Final = 12  # of a trial: three bands of four [assumed]


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


def check_duration(trial: Trial) -> None:
    """Refuse a trial that is too short to have a spectrum."""
    if coefficient_count(len(trial), trial.step_s) < LEAST_COEFFICIENTS:
        raise InputError(
            trial.path if trial.path.name else trial.name,
            f"lasts {len(trial) * trial.step_s:.2g} s",
            f"give at least {LEAST_COEFFICIENTS / (2 * HIGHEST_HZ):.2g} s of motion",
        )


def aligned(trials: TrialSet) -> TrialSet:
    """Trials whose rest is that of their goals; those of one motion get equal rests and ends.

    Trials are not cut to match one whose motion is shorter by more than a tenth [assumed].
    """
    starts = [motion_start(t) for t in trials]
    motions: dict[str, list[int]] = defaultdict(list)
    for k, trial in enumerate(trials):
        motions[trial_group_key(with_rows(trial, slice(2), 0))].append(k)  # whatever its length
    result = list(trials)
    for members in motions.values():
        rest, common = min(starts[k] for k in members), 0
        moving = {k: len(result[k]) - starts[k] for k in members}
        for k in sorted(members, key=moving.__getitem__):
            if 0.9 * moving[k] > common:
                common = moving[k]
            result[k] = with_rows(result[k], slice(starts[k] - rest, starts[k] + common), rest)
    return TrialSet(tuple(result))


def trial_groups(trials: Sequence[Trial], outputs: Sequence[str]) -> list[TrialGroup]:
    """Groups of the trials, with the signals that were measured and are simulated."""
    members: dict[tuple[str, tuple[str, ...]], list[int]] = defaultdict(list)
    for k, trial in enumerate(trials):
        measured = measured_signals(trial)
        signals = tuple(s for s in outputs if s in measured and np.isfinite(measured[s]).any())
        if not signals:
            raise nothing_measured(trial, outputs)
        check_duration(trial)
        members[trial_group_key(trial), signals].append(k)
    result = []
    for (key, signals), rows in members.items():
        first = trials[rows[0]]
        count = coefficient_count(len(first), first.step_s)
        result.append(TrialGroup(key, tuple(rows), signals, count))
    return result


def group_frequencies_hz(group: TrialGroup, trials: Sequence[Trial]) -> Array:
    """Frequencies of the coefficients of a group, shape (K,)."""
    first = trials[group.trials[0]]
    return coefficient_frequencies_hz(group.coefficients, len(first), first.step_s)


NOT_FOLLOWED_RAD: Final = 0.03
"""Following error, beyond the largest of the twin, above which a goal counts as not followed
[assumed]."""


def rows_that_follow(trial: Trial, usual_error_rad: Array) -> Array:
    """1 for each row before a joint stops following its goal, 0 after, shape (n,).

    There the current saturates and the joint falls behind. Two such falls differ, so no simulation
    reproduces them. Where angle or current were not measured, every row counts. `usual_error_rad`
    has shape (joints,).
    """
    joints = range(1, trial.meta.dof + 1)
    needed = {q.format(j) for q in ("goal_{}_rad", "angle_{}_rad", "current_{}_a") for j in joints}
    if not trial.columns.keys() >= needed:
        return np.ones(len(trial))
    error, current = np.abs(trial.goal_rad - trial.angle_rad), np.abs(trial.current_a)
    behind = error > usual_error_rad + NOT_FOLLOWED_RAD
    saturated = current > 0.95 * current.max(axis=0)  # [assumed]
    not_followed = np.any(behind & saturated, axis=1)
    return np.asarray(np.cumsum(not_followed) == 0, dtype=np.float64)


def interpolate_missing(rows: Array) -> Array:
    """Rows with missing values interpolated; zero if all are missing."""
    measured = np.isfinite(rows)
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

VARIED_EFFECTS: Final = ("payload_offset", "sync_offset")
"""Effects whose strength varies between trials of a link."""

SHARED: Final = "sync_s"
"""Variation whose mean over the trials is none: a clock error common to all trials is a property of
the set-up. The gap workflow fits it as `synchronisation`."""

KNOWN_FRACTION: Final = 0.01
"""Standard deviation of a mean that counts as known, over its standard deviation by chance
[assumed]: small enough to hold the mean, large enough to keep matrices regular."""

ECCENTRICITY_M: Final = 0.003  # of the payload: standard deviation between repetitions [assumed]


class Variation(NamedTuple):
    """What varies from one repetition of a trial to the next: a direction in the twin."""

    name: str
    parameters: Mapping[str, float]  # Change of each plant parameter per unit
    outputs: Mapping[str, float]  # Direct change of each output per unit
    standard_deviation: float


def trial_variation(plant: Plant, known: Sequence[str], trial: Trial) -> list[Variation]:
    """Pressure, friction, payload, clock and frame of a trial; nothing for loads but the link.

    `plant` has `VARIED_EFFECTS`; `known` names the parameters that its twin has. The standard
    deviations are assumed.
    """
    if plant.load != "link":
        return []
    q = {name: plant.parameters[name] for name in known}
    stiff = {n: p.value for n, p in q.items() if p.unit == "N.m/rad"}
    stiff |= {n: p.value for n, p in q.items() if n == "root_limit_moment_nm"}
    friction = {n: p.value for n, p in q.items() if "_friction_" in n}
    length_m = trial.meta.link_length_m or plant.parameters["link_length_m"].value
    return [
        Variation("pressure", stiff, {}, 0.01),
        Variation("friction", friction, {}, 0.05),
        Variation("eccentricity_m", {"payload_offset_share": 1 / length_m}, {}, ECCENTRICITY_M),
        Variation(SHARED, {"sync_offset_s": 1.0}, {}, 0.002),
        *(Variation("frame_m", {}, {axis: 1.0}, 0.0003) for axis in TIP),
    ]


LONGEST_SUBSTEP_S: Final = 2.9e-3
"""Longest internal step of the link's simulation: what a dead time of zero allows
(`models.plant.effects.command`). Measured: six a period are within 5 µm and 0.5 mA of a step of
0.25 ms; 46 µm with ten times the usual friction. Other loads keep the step of their model: the
bristles of a small gear are faster."""

FIT_STEPS: Final = 12  # at most, of the variation between trials [assumed]


class _VariedTwin:
    """Residual spectra of trials, as a function of the variation of each trial."""

    def __init__(self, plant: Plant, trials: Sequence[Trial]) -> None:
        is_link = plant.load == "link"
        varied = plant.with_effects(*VARIED_EFFECTS) if is_link else plant
        model = varied.step_model(trials[0].meta.dof, "twin")
        if is_link:
            model = model.with_substeps(LONGEST_SUBSTEP_S)
        self.plant, self.trials = plant, shortened(trials, model)
        self.units = {v.name: v.unit for v in model.outputs}
        self.groups = trial_groups(self.trials, list(self.units))
        self._measured = [measured_signals(t) for t in self.trials]
        known = names(model.parameters)
        variation = [trial_variation(varied, known, t) for t in self.trials]
        each = len(variation[0])
        self.size = each * len(self.trials)
        self._shared = np.array([v.name == SHARED for row in variation for v in row])
        self._deviation = np.array([v.standard_deviation for row in variation for v in row])
        moved = list(dict.fromkeys(n for row in variation for v in row for n in v.parameters))
        self._model = CompiledModel(model, moved)
        self._columns = [known.index(name) for name in moved]
        # Change of the moved parameters and of the outputs by each variation of each trial
        self._by_parameter = np.zeros((len(self.trials), len(moved), each))
        self._by_output = np.zeros((len(self.trials), len(self.units), each))
        for k, row in enumerate(variation):
            for v, (_, parameters, outputs, _) in enumerate(row):
                self._by_parameter[k, :, v] = [parameters.get(name, 0.0) for name in moved]
                self._by_output[k, :, v] = [outputs.get(name, 0.0) for name in self.units]
        self._last: tuple[bytes | None, list[tuple[Array, Array]]] = (None, [])
        self._follows = [np.ones(len(t)) for t in self.trials]
        if is_link:
            joints = range(1, trials[0].meta.dof + 1)
            angles = [list(self.units).index(f"angle_{j}_rad") for j in joints]
            for k, (y, _) in enumerate(self._runs(np.zeros(self.size))):
                error_rad = np.abs(self.trials[k].goal_rad - y[:, angles]).max(axis=0)
                self._follows[k] = rows_that_follow(self.trials[k], error_rad)

    def _runs(self, values: Array) -> list[tuple[Array, Array]]:
        """Outputs (n, outputs) of each trial, and their derivatives (n, outputs, variations)."""
        if values.tobytes() != self._last[0]:
            by_trial = values.reshape(len(self.trials), -1)
            with ThreadPoolExecutor(WORKERS) as pool:
                runs = list(pool.map(self._run, range(len(self.trials)), by_trial))
            self._last = (values.tobytes(), runs)
        return self._last[1]

    def _run(self, k: int, values: Array) -> tuple[Array, Array]:
        variables = self._model.model.parameters
        p = trial_parameters(self._model.model, self.trials[k])
        p[self._columns] += self._by_parameter[k] @ values
        p = np.clip(p, [v.minimum for v in variables], [v.maximum for v in variables])
        y, slopes = differentiate_trial(self._model, self.trials[k], p)
        with np.errstate(over="ignore", invalid="ignore"):  # an unstable simulation
            y = y + self._by_output[k] @ values
            return y, slopes @ self._by_parameter[k] + self._by_output[k]

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

        def spectrum(k: int, signal: str, count: int) -> Array:
            column = rows[k][:, place[signal]]
            return signal_spectrum(self.trials[k], signal, column, self._follows[k], count)

        return [
            np.array([[spectrum(k, s, g.coefficients) for s in g.signals] for k in g.trials])
            for g in self.groups
        ]

    def fit(self, floor: MeasuredFloor, start: Array) -> Array:
        """Variation of all trials with the least cost in units of a floor, priors included."""
        if not self.size:
            return start
        whiteners = [_whitener(floor, g, self.trials) for g in self.groups]
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
            residual, start, jacobian, x_scale=self._deviation, ftol=1e-4,
            max_nfev=FIT_STEPS, tr_solver="lsmr",
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


def guessed_floor(
    groups: Sequence[TrialGroup], trials: Sequence[Trial], units: Mapping[str, str]
) -> MeasuredFloor:
    """Flat floor from the usual error of each signal, before any residual is known."""
    noise = {}
    for signal in dict.fromkeys(s for g in groups for s in g.signals):
        measured = [t.columns[signal] for t in trials if signal in t.columns]
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
