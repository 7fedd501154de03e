"""Twin on a motion that has not been run: outputs, and their derivatives by its coefficients.

The goals of a Fourier series are linear in its coefficients, so a model whose inputs are the
windowed sines and cosines, and whose further parameters are the coefficients, has their exact
sensitivities from the same variational equation as any other parameter's.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from firmware_py.motion_document import fourier_basis
from firmware_py.signals import PERIOD_S
from models.gap.residuals.fit_parameters import FitParameter, moved_parameters
from models.plant.identification.noise_floor import Array
from models.plant.simulation.runner import CompiledModel, trial_inputs, trial_parameters
from models.plant.step_model import StepModel, Variable, names
from models.trials.trial import Trial


class MotionTwin:
    """Twin with every effect, on trials with one number of joints.

    `fit_parameters`: directions in which it may change; all act on every trial.
    """

    def __init__(self, model: StepModel, fit_parameters: Sequence[FitParameter]) -> None:
        known, outputs = names(model.parameters), names(model.outputs)
        moved = [n for n in moved_parameters(fit_parameters) if n in known]
        self.model, self.outputs = model, outputs
        self._plain, self._sensitive = CompiledModel(model), CompiledModel(model, moved)
        self._by_parameter = np.zeros((len(known), len(fit_parameters)))
        self._by_output = np.zeros((len(outputs), len(fit_parameters)))
        for k, q in enumerate(fit_parameters):
            for name, weight in q.parameters.items():
                self._by_parameter[known.index(name), k] = weight
            for name, weight in q.outputs.items():
                self._by_output[outputs.index(name), k] = weight
        self._moved = self._by_parameter[[known.index(n) for n in moved]]
        self._low = np.array([v.minimum for v in model.parameters])
        self._high = np.array([v.maximum for v in model.parameters])

    def parameters(self, trial: Trial, values: Array) -> Array:
        """Parameter vector of the model for values of the fit parameters."""
        p = trial_parameters(self.model, trial) + self._by_parameter @ values
        return np.asarray(np.clip(p, self._low, self._high))

    def run(self, trial: Trial, values: Array) -> Array:
        """Outputs, shape (n, outputs)."""
        first, u = trial_inputs(self.model, trial)
        p = self.parameters(trial, values)
        y = self._plain.simulate(u, trial.step_s, p, self._plain.start(first, p))
        return np.asarray(y + self._by_output @ values)

    def slopes(self, trial: Trial, values: Array) -> tuple[Array, Array]:
        """Outputs, and their derivatives by the fit parameters, shape (n, outputs, p)."""
        first, u = trial_inputs(self.model, trial)
        y, slope = self._sensitive.derivatives(
            u, trial.step_s, self.parameters(trial, values), first
        )
        return y + self._by_output @ values, np.asarray(slope @ self._moved + self._by_output)


class CoefficientTwin:
    """Twin with the coefficients of a Fourier series as its parameters."""

    def __init__(
        self, model: StepModel, duration_s: float, harmonics: tuple[int, ...], dof: int,
        rest_samples: int,
    ) -> None:  # fmt: skip
        rows = rest_samples + round(duration_s / PERIOD_S)
        at_s = (np.arange(rows, dtype=np.float64) - rest_samples) * PERIOD_S
        self.basis = fourier_basis(at_s, duration_s, harmonics)
        count = self.basis.shape[1]
        driven = with_coefficients(model, count, dof)
        wrt = names(driven.parameters)[len(model.parameters) :]
        self._sensitive, self._count = CompiledModel(driven, wrt), count

    def slopes(self, payload_kg: float, p: Array, coefficients: Array) -> tuple[Array, Array]:
        """Outputs, and their derivatives by the coefficients, shape (n, outputs, coefficients).

        Shapes: `coefficients` (joints * count,).
        """
        u = np.column_stack([self.basis, np.full(len(self.basis), payload_kg)])
        return self._sensitive.derivatives(
            u[:-1], PERIOD_S, np.concatenate([p, coefficients]), u[0]
        )


def with_coefficients(model: StepModel, count: int, dof: int) -> StepModel:
    """Model whose goals are sums of inputs, weighted by further parameters."""
    inputs = tuple(Variable(f"basis_{k + 1}", "1") for k in range(count))
    others = tuple(v for v in model.inputs if not v.name.startswith("goal_"))
    weights = tuple(
        Variable(f"coefficient_{j + 1}_{k + 1}", "rad") for j in range(dof) for k in range(count)
    )
    kept = len(model.parameters)
    known = names(others)

    def inner(u: ca.SX, p: ca.SX) -> tuple[ca.SX, ca.SX]:
        own = p[kept:]
        goals = {
            f"goal_{j + 1}_rad": ca.dot(own[j * count : (j + 1) * count], u[:count])
            for j in range(dof)
        }
        row = [
            goals[v.name] if v.name in goals else u[count + known.index(v.name)]
            for v in model.inputs
        ]
        return ca.vertcat(*row), p[:kept]

    name = f"{model.name}_by_coefficients"
    return model.rewired(name, inputs + others, model.parameters + weights, inner)
