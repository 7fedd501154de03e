"""Twin that is run together with the exact derivatives of its tip by coefficients of the goals.

The derivatives A = ∂x⁺/∂x and B = ∂x⁺/∂u of each step of the compiled twin are those of the
discrete step (variational equation, `models.plant.simulation.runner`). Along a run they give
the derivatives of the state by the coefficients c of the goals u = b(t) c by S⁺ = A S + B b. So the
C code does not depend on the path, and a path of any length needs no other compilation.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import replace

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from models.plant.simulation.runner import CompiledModel
from models.plant.step_model import StepModel, Variable, names

Array = NDArray[np.float64]


class TipTwin:
    """The twin of a plant, driven by goals, with its tip in the horizontal plane.

    `model`: twin with the inputs `goal_j_rad` and `payload_kg` and the outputs `tip_x_m`,
    `tip_y_m`.
    """

    def __init__(self, model: StepModel, dof: int, period_s: float) -> None:
        self.dof, self.period_s = dof, period_s
        self._model, self._plain = model, CompiledModel(model)
        self._p = model.parameter_values()
        outputs = names(model.outputs)
        self._tip = [outputs.index(n) for n in ("tip_x_m", "tip_y_m")[:dof]]
        self._tip3 = [outputs.index(f"tip_{a}_m") for a in "xyz"]
        self._current = [outputs.index(f"current_{j + 1}_a") for j in range(dof)]
        self._angle = [outputs.index(f"angle_{j + 1}_rad") for j in range(dof)]
        self._stepper: CompiledModel | None = None

    def changed(self, values: Mapping[str, float]) -> TipTwin:
        """Twin with other parameter values; names that it lacks are ignored."""
        known = set(names(self._model.parameters))
        other = copy.copy(self)
        other._p = self._model.parameter_values({n: v for n, v in values.items() if n in known})
        return other

    def run(self, goals_rad: Array, payload_kg: float) -> Array:
        """Outputs at every row of a table of goals, shape (n, outputs), starting at rest at the
        first row.

        Shapes: `goals_rad` (n, dof).
        """
        u = np.column_stack([goals_rad, np.full(len(goals_rad), payload_kg)])
        x = self._plain.start(u[0], self._p)
        return self._plain.simulate(u[:-1], self.period_s, self._p, x)

    def tip_m(self, outputs: Array) -> Array:
        """Planned coordinates of the tip, from outputs, shape (n, dof)."""
        return outputs[:, self._tip]

    def tip_in_space_m(self, outputs: Array) -> Array:
        """Tip in the world frame, from outputs, shape (n, 3)."""
        return outputs[:, self._tip3]

    def current_a(self, outputs: Array) -> Array:
        """Motor currents, from outputs, shape (n, dof)."""
        return outputs[:, self._current]

    def angle_rad(self, outputs: Array) -> Array:
        """Joint angles, from outputs, shape (n, dof)."""
        return outputs[:, self._angle]

    def resting_tip_m(self, goal_rad: Array, payload_kg: float) -> Array:
        """Tip of the arm at rest, shape (dof,).

        Shapes: `goal_rad` (dof,).
        """
        return np.asarray(self.tip_m(self.run(np.tile(goal_rad, (2, 1)), payload_kg))[0])

    def held_tip_m(self, goal_rad: Array, payload_kg: float, ramp_s: float, hold_s: float) -> Array:
        """Tip at the end of an approach from zero goals, shape (dof,).

        It falls short of the tip at rest: friction stops the joints before their goals, and the
        link creeps. The goals rise linearly for `ramp_s` and are then held for `hold_s`.

        Shapes: `goal_rad` (dof,).
        """
        time_s = np.arange(round((ramp_s + hold_s) / self.period_s) + 1) * self.period_s
        goals = np.minimum(time_s / ramp_s, 1.0)[:, None] * goal_rad
        return np.asarray(self.tip_m(self.run(goals, payload_kg))[-1])

    def derivatives_at_rest(self, goal_rad: Array, payload_kg: float) -> tuple[Array, Array]:
        """Derivatives of state and tip after a period by the state before, at rest.

        Shapes: `goal_rad` (dof,).
        """
        stepper, size = self._one_step(), len(self._model.states)
        x = self._plain.start(np.append(goal_rad, payload_kg), self._p)
        p = np.concatenate([self._p, x, goal_rad])
        _, by = stepper.derivatives(np.array([[payload_kg]]), self.period_s, p)
        return by[1, :size, :size], by[1, [size + k for k in self._tip], :size]

    def _one_step(self) -> CompiledModel:
        if self._stepper is None:
            self._stepper = _step_derivatives(self._model, self.dof)
        return self._stepper

    def slopes(self, goals_rad: Array, basis: Array, payload_kg: float) -> Array:
        """Derivatives of the tip by the coefficients of the goals, shape (n, dof, dof * count).

        `basis`: value of each basis function at each row; every joint has its own coefficients.

        Shapes: `goals_rad` (n, dof), `basis` (n, count).
        """
        stepper = self._one_step()
        sizes, count = len(self._model.states), basis.shape[1]
        payload = np.array([[payload_kg]])
        u0 = np.append(goals_rad[0], payload_kg)
        x, slope = self._plain.start(u0, self._p), np.zeros((sizes, self.dof * count))
        result = np.zeros((len(goals_rad), self.dof, self.dof * count))
        for k, goal in enumerate(goals_rad[:-1]):
            p = np.concatenate([self._p, x, goal])
            y, by = stepper.derivatives(payload, self.period_s, p)
            x, by_x, by_u = y[1, :sizes], by[1, :, :sizes], by[1, :, sizes:]
            moved = by_x @ slope
            for j in range(self.dof):
                moved[:, j * count : (j + 1) * count] += np.outer(by_u[:, j], basis[k])
            slope, tip = moved[:sizes], moved[sizes:]
            result[k + 1] = tip[self._tip]
        return result


def _step_derivatives(model: StepModel, dof: int) -> CompiledModel:
    """One step of a model, with its initial state and the held goals as parameters."""
    states = tuple(Variable(f"start_of_{v.name}", v.unit) for v in model.states)
    goals = tuple(Variable(f"held_goal_{j + 1}_rad", "rad") for j in range(dof))
    kept, size = len(model.parameters), len(model.states)

    def own(u: ca.SX, p: ca.SX) -> tuple[ca.SX, ca.SX]:
        return ca.vertcat(p[kept + size :], u), p[:kept]

    name, parameters = f"{model.name}_one_step", model.parameters + states + goals
    driven = model.rewired(name, (model.inputs[-1],), parameters, own)
    x, u, p = ca.SX.sym("x", size), ca.SX.sym("u"), ca.SX.sym("p", len(parameters))
    driven = replace(
        driven,
        outputs=model.states + model.outputs,
        initial=ca.Function("initial", [u, p], [p[kept : kept + size]]),
        output=ca.Function("output", [x, u, p], [ca.vertcat(x, driven.output(x, u, p))]),
    )
    return CompiledModel(driven, names(states + goals))
