"""Evaluation of a plant on trials: the twin, driven by their goals, compared with measurements.

Motion capture and servos have two clocks. Where they differ by a few milliseconds, the tip's error
is that of the plant and of the clock together: a tip at 0.5 m/s is 4 mm off after 8 ms. So the
tip's error is stated twice, as it is and with the clock of each trial refitted.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

from firmware_py.core.errors import InputError
from firmware_py.core.units import PAYLOAD
from models.plant.document import (
    CLOCK_LIMIT_S,
    DofEvaluation,
    Evaluation,
    SignalError,
    TipError,
)
from models.plant.identification.fit import measured_signals
from models.plant.plant import Plant
from models.plant.simulation.runner import Array, CompiledModel, run_trial
from models.plant.step_model import names
from models.shared.kinematics import rigid_tip_m
from models.shared.notebook import plot_against
from models.trials.origin import origins_of
from models.trials.trial import Trial

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TIP: Final = ("tip_x_m", "tip_y_m", "tip_z_m")


@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """Measured trial beside its simulation; `compare_with_trials` makes it.

    Attributes
    ----------
    trial : Trial
        Measured trial.
    simulated, measured : dict of str to ndarray, shape (n,)
        Samples by name of every signal that both have, in SI units.

    Examples
    --------
    >>> from models.trials.trial import TrialMeta
    >>> meta = TrialMeta(dof=1, payload_kg=0.0, trial=1, motion="rest", source="measured",
    ...                  period_s=1.0, rest_samples=1)
    >>> trial = Trial("rest", meta, {"time_s": 0.1 * np.arange(3), "position_1_m": np.zeros(3)})
    >>> both = Comparison(trial, {"position_1_m": np.full(3, 0.01)}, {"position_1_m": np.zeros(3)})
    >>> both
    <Comparison rest: position_1_m>
    >>> both.error("position_1_m")
    array([0.01, 0.01, 0.01])
    """

    trial: Trial
    simulated: dict[str, Array]
    measured: dict[str, Array]

    def __repr__(self) -> str:
        return f"<Comparison {self.trial.name}: {', '.join(self.simulated)}>"

    def plot(self) -> Figure:
        """Draw every signal over time, measured and simulated."""
        return plot_against([(self.trial.name, self.trial.time_s, self.measured, self.simulated)])

    def error(self, signal: str) -> Array:
        """Return simulated minus measured, shape (n,); NaN where nothing was measured."""
        return self.simulated[signal] - self.measured[signal]

    @property
    def has_tip(self) -> bool:
        """Whether the end effector was measured."""
        return all(axis in self.simulated for axis in TIP)

    def tip_error_m(self, clock_s: float = 0.0) -> Array:
        """Return the error of the end effector, shape (n, 3); NaN where it was not measured.

        The motion capture is taken to be late by `clock_s` against the servos.
        """
        simulated = np.column_stack([self.simulated[axis] for axis in TIP])
        measured = np.column_stack([self.measured[axis] for axis in TIP])
        if clock_s:
            time_s = self.trial.time_s
            at = np.clip(time_s - clock_s, time_s[0], time_s[-1])
            simulated = CubicSpline(time_s, simulated)(at)
        return simulated - measured

    @cached_property
    def clock_s(self) -> float:
        """Offset of the motion capture's clock with the least error of the tip, in s.

        Positive where the motion capture is late; within `CLOCK_LIMIT_S`; 0 without a tip.
        """
        if not self.has_tip or not (rows := np.isfinite(self.tip_error_m()).all(axis=1)).any():
            return 0.0

        def error(fraction: Array) -> Array:
            return self.tip_error_m(float(fraction[0]) * CLOCK_LIMIT_S)[rows].ravel()

        return float(CLOCK_LIMIT_S * least_squares(error, [0.0], bounds=(-1.0, 1.0)).x[0])

    def columns(self) -> dict[str, Array]:
        """Return time and all signals by name: `time_s`, `measured_NAME`, `simulated_NAME`."""
        both = {"measured": self.measured, "simulated": self.simulated}
        return {"time_s": self.trial.time_s} | {
            f"{which}_{s}": both[which][s] for s in self.simulated for which in both
        }


def compare_with_trials(plant: Plant, trials: Iterable[Trial]) -> list[Comparison]:
    """Simulate trials with the twin: goals as sent, payload as declared.

    Parameters
    ----------
    plant : Plant
        Plant to simulate.
    trials : iterable of Trial
        Measured trials.

    Returns
    -------
    list of Comparison
        One for each trial, in their order.

    Raises
    ------
    InputError
        If a trial lacks an input of the plant or has no signal that the plant simulates, or if the
        simulation does not stay finite.

    Examples
    --------
    >>> from models.plant.plant import NOMINAL, read_plant
    >>> from models.trials.trial import TrialMeta
    >>> plant = read_plant(NOMINAL.parent / "examples" / "emps_identified.json")
    >>> meta = TrialMeta(dof=1, payload_kg=0.0, trial=1, motion="rest", source="measured",
    ...                  period_s=1.0, rest_samples=1)
    >>> columns = {"time_s": np.arange(50) * 1e-3}
    >>> columns |= {"command_1_v": np.zeros(50), "position_1_m": np.zeros(50)}
    >>> compare_with_trials(plant, [Trial("rest", meta, columns)])
    [<Comparison rest: position_1_m>]
    """
    compiled: dict[int, CompiledModel] = {}
    result = []
    for trial in trials:
        dof = trial.meta.dof
        if dof not in compiled:
            compiled[dof] = CompiledModel(plant.step_model(dof, "twin"))
        y, measured = run_trial(compiled[dof], trial), measured_signals(trial)
        outputs = names(compiled[dof].model.outputs)
        simulated = {s: y[:, k] for k, s in enumerate(outputs) if s in measured}
        if not any(np.isfinite(measured[s]).any() for s in simulated):
            raise nothing_measured(trial, outputs)
        if not all(np.isfinite(column).all() for column in simulated.values()):
            raise InputError(
                f"plant {plant.name!r}", f"does not stay finite on trial {trial.name}",
                "identify it on trials of this link",
            )  # fmt: skip
        result.append(Comparison(trial, simulated, {s: measured[s] for s in simulated}))
    return result


def nothing_measured(trial: Trial, outputs: Sequence[str]) -> InputError:
    """Error for a trial without any measured signal among the outputs of a plant."""
    return InputError(
        trial.path, "has no measured signal that the plant simulates",
        "declare one of " + ", ".join(outputs) + " and give its samples",
    )  # fmt: skip


def signal_errors(plant: Plant, comparisons: Sequence[Comparison]) -> dict[str, SignalError]:
    """Errors of each signal over all measured rows of all trials."""
    dofs = sorted({c.trial.meta.dof for c in comparisons})
    units = {v.name: v.unit for dof in dofs for v in plant.step_model(dof, "twin").outputs}
    result = {}
    for signal, unit in units.items():
        parts = [c.error(signal) for c in comparisons if signal in c.simulated]
        error = np.concatenate([part[np.isfinite(part)] for part in parts] or [np.empty(0)])
        if len(error):
            rms, mae = np.sqrt(np.mean(error**2)), np.mean(np.abs(error))
            result[signal] = SignalError(float(rms), float(mae), unit)
    return result


def tip_rms_m(comparisons: Sequence[Comparison]) -> float | None:
    """Return the root mean square error of the end effector.

    Parameters
    ----------
    comparisons : sequence of Comparison
        Trials beside their simulations.

    Returns
    -------
    float or None
        Error in m over all measured rows; None if the end effector was not measured.

    Examples
    --------
    >>> from models.trials.trial import TrialMeta
    >>> meta = TrialMeta(dof=1, payload_kg=0.0, trial=1, motion="rest", source="measured",
    ...                  period_s=1.0, rest_samples=1)
    >>> trial = Trial("rest", meta, {"time_s": 0.1 * np.arange(3)})
    >>> measured, simulated = ({axis: np.full(3, m) for axis in TIP} for m in (0.0, 0.001))
    >>> round(tip_rms_m([Comparison(trial, simulated, measured)]), 6)
    0.001732
    """
    return _root_mean_square([c.tip_error_m() for c in comparisons if c.has_tip])


def _root_mean_square(errors_m: Sequence[Array]) -> float | None:
    """Root mean square distance over all measured rows of errors (n, 3); None without any."""
    squares = [np.sum(error**2, axis=1) for error in errors_m]
    measured = np.concatenate([part[np.isfinite(part)] for part in squares] or [np.empty(0)])
    return float(np.sqrt(np.mean(measured))) if len(measured) else None


def _tip_errors(comparisons: Sequence[Comparison]) -> dict[str, float | None]:
    """Fields of a `TipError`."""
    measured = [c for c in comparisons if c.has_tip]
    rigid = [
        rigid_tip_m(t.angle_rad, t.meta.base_offset_m, t.meta.link_length_m) - t.tip_m
        for t in (c.trial for c in measured if "angle_1_rad" in c.simulated)
    ]
    return {
        "tip_rms_m": tip_rms_m(measured),
        "rigid_tip_rms_m": _root_mean_square(rigid),
        "clock_tip_rms_m": _root_mean_square([c.tip_error_m(c.clock_s) for c in measured]),
    }


def evaluate_plant(plant: Plant, trials: Iterable[Trial]) -> Evaluation:
    """Return the errors of a plant on trials, as `evaluate --json` prints them.

    Parameters
    ----------
    plant : Plant
        Plant to simulate.
    trials : iterable of Trial
        Measured trials of one or two joints.

    Returns
    -------
    Evaluation
        Errors over all trials, by number of joints and by payload.

    Raises
    ------
    InputError
        If a trial lacks an input of the plant, or the simulation does not stay finite on it.

    Examples
    --------
    >>> from models.plant.plant import NOMINAL, read_plant
    >>> from models.trials.trial import TrialMeta
    >>> plant = read_plant(NOMINAL.parent / "examples" / "emps_identified.json")
    >>> meta = TrialMeta(dof=1, payload_kg=0.0, trial=1, motion="rest", source="measured",
    ...                  period_s=1.0, rest_samples=1)
    >>> columns = {"time_s": np.arange(50) * 1e-3}
    >>> columns |= {"command_1_v": np.zeros(50), "position_1_m": np.zeros(50)}
    >>> result = evaluate_plant(plant, [Trial("rest", meta, columns)])
    >>> result.trials, result.signals["position_1_m"].unit
    (1, 'm')
    >>> result.signals["position_1_m"].rms < 1e-3
    True
    """
    comparisons = compare_with_trials(plant, trials)
    dofs = {}
    for dof in sorted({c.trial.meta.dof for c in comparisons}):
        rows = [c for c in comparisons if c.trial.meta.dof == dof]
        by_load = {
            load: [c for c in rows if c.trial.meta.payload_kg == load]
            for load in sorted({c.trial.meta.payload_kg for c in rows})
        }
        dofs[str(dof)] = DofEvaluation(
            signals=signal_errors(plant, rows),
            trials=len(rows),
            payloads={f"{load:g}": TipError(**_tip_errors(part)) for load, part in by_load.items()},
            **_tip_errors(rows),
        )
    return Evaluation(
        signals=signal_errors(plant, comparisons),
        trials=len(comparisons),
        dof=dofs,
        origins=origins_of(c.trial for c in comparisons),
        clocks_s={c.trial.name: c.clock_s for c in comparisons if c.has_tip},
        **_tip_errors(comparisons),
    )


def over_payloads(trials: Sequence[Trial], fractions: Sequence[float]) -> list[Trial]:
    """Trials of each number of joints at these fractions of their order by payload."""
    chosen: list[Trial] = []
    for dof in sorted({t.meta.dof for t in trials}):
        same = sorted((t for t in trials if t.meta.dof == dof), key=lambda t: t.meta.payload_kg)
        last = len(same) - 1
        chosen += [same[k] for k in sorted({min(int(f * len(same)), last) for f in fractions})]
    return chosen


def plot_fit(plant: Plant, trials: Sequence[Trial]) -> Figure:
    """Measured and simulated signals of the smallest and the largest payload, by joints."""
    runs = []
    for c in compare_with_trials(plant, over_payloads(trials, (0.0, 1.0))):
        head = f"{c.trial.meta.dof}DOF, {PAYLOAD.significant(c.trial.meta.payload_kg)}"
        runs.append((head, c.trial.time_s, c.measured, c.simulated))
    return plot_against(runs, f"{plant.name}: measured, and simulated from the goals")
