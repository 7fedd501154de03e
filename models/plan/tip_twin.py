"""Twin driven by goals, with the exact derivatives of its tip by coefficients of the goals.

The derivatives A = ∂x⁺/∂x and B = ∂x⁺/∂u of each step of the compiled twin are those of the
discrete step (variational equation, `models.plant.simulation.runner`). Along a run they give
the derivatives of the state by the coefficients c of the goals u = b(t) c by S⁺ = A S + B b. So the
C code does not depend on the path, and a path of any length needs no other compilation.
"""

from __future__ import annotations

import copy
import functools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from models.plant.plant import Plant
from models.plant.simulation.runner import CompiledModel
from models.plant.step_model import ARGUMENTS, Variable, names

Array = NDArray[np.float64]
MOVING_RAD_S: Final = 0.1
"""Joint rate below which dry friction can take any value: at this rate a sample of the current has
half its weight. It is the observer's `learning_rate_rad_s`."""


@dataclass(frozen=True)
class TwinRun:
    """Run of a twin, one row per control period."""

    payload_kg: float
    goals_rad: Array  # (n, dof)
    angle_rad: Array  # (n, dof)
    current_a: Array  # (n, dof)
    position_m: Array  # (n, 3), tip in the world frame
    tip_m: Array  # (n, dof), its planned coordinates: x, and y with two joints


class TipTwin:
    """The twin of a plant of the link, driven by goals, with its tip in the horizontal plane."""

    def __init__(self, plant: Plant, dof: int, period_s: float) -> None:
        if plant.load != "link":
            raise InputError(
                f"plant {plant.name!r}", "is not the link", "plans are made for the link alone"
            )
        model = plant.step_model(dof)
        self.dof, self.period_s = dof, period_s
        self.reach_m = sum(plant.parameters[n].value for n in ("base_offset_m", "link_length_m"))
        self._model, self._plain = model, CompiledModel(model)
        self._p = model.parameter_values()
        outputs = names(model.outputs)
        self._tip3 = [outputs.index(f"tip_{axis}_m") for axis in "xyz"]
        self._current = [outputs.index(f"current_{j + 1}_a") for j in range(dof)]
        self._angle = [outputs.index(f"angle_{j + 1}_rad") for j in range(dof)]

    def scaled(self, factors: Mapping[str | tuple[str, ...], float]) -> TipTwin:
        """Twin with parameters multiplied by factors, by the beginnings of their names."""
        other = copy.copy(self)
        other._p = self._model.parameter_values({
            v.name: factor * v.start
            for begins, factor in factors.items()
            for v in self._model.parameters
            if v.name.startswith(begins)
        })  # fmt: skip
        return other

    def parameters(self, begins: str) -> list[str]:
        """Names of the parameters with that beginning."""
        return [n for n in names(self._model.parameters) if n.startswith(begins)]

    def run(self, goals_rad: Array, payload_kg: float) -> TwinRun:
        """Run of a table of goals (n, dof), from rest at the first row."""
        u = np.column_stack([goals_rad, np.full(len(goals_rad), payload_kg)])
        x = self._plain.start(u[0], self._p)
        y = self._plain.simulate(u[:-1], self.period_s, self._p, x)
        return TwinRun(
            payload_kg, goals_rad, y[:, self._angle], y[:, self._current], y[:, self._tip3],
            y[:, self._tip3[: self.dof]],
        )  # fmt: skip

    def resting_tip_m(self, goal_rad: Array, payload_kg: float) -> Array:
        """Tip of the relaxed arm at goals of shape (dof,), shape (dof,)."""
        return np.asarray(self.run(np.tile(goal_rad, (2, 1)), payload_kg).tip_m[0])

    def resting_slope(self, goal_rad: Array, payload_kg: float) -> Array:
        """Derivatives of the resting tip by the goals, by differences, shape (dof, dof)."""
        step_rad = 1e-3
        tip = self.resting_tip_m(goal_rad, payload_kg)
        probes = (goal_rad + step_rad * unit for unit in np.eye(self.dof))
        return np.column_stack(
            [(self.resting_tip_m(p, payload_kg) - tip) / step_rad for p in probes]
        )

    def slopes(self, goals_rad: Array, basis: Array, payload_kg: float) -> Array:
        """Derivatives of the tip by the coefficients of the goals, shape (n, dof, dof * count).

        `basis`, shape (n, count): value of each basis function at each row. The coefficients of the
        first joint come first.
        """
        stepper, sizes, count = self._stepper, len(self._model.states), basis.shape[1]
        payload, tip = np.array([[payload_kg]]), self._tip3[: self.dof]
        x = self._plain.start(np.append(goals_rad[0], payload_kg), self._p)
        slope = np.zeros((sizes, self.dof * count))
        result = np.zeros((len(goals_rad), self.dof, self.dof * count))
        for k, goal in enumerate(goals_rad[:-1]):
            p = np.concatenate([self._p, x, goal])
            y, by = stepper.derivatives(payload, self.period_s, p)
            x, by_x, by_u = y[1, :sizes], by[1, :, :sizes], by[1, :, sizes:]
            moved = by_x @ slope
            for j in range(self.dof):
                moved[:, j * count : (j + 1) * count] += np.outer(by_u[:, j], basis[k])
            slope, result[k + 1] = moved[:sizes], moved[sizes:][tip]
        return result

    @functools.cached_property
    def _stepper(self) -> CompiledModel:
        """One step of the model, with its initial state and the goals as parameters."""
        model = self._model
        states = tuple(Variable(f"start_of_{v.name}", v.unit) for v in model.states)
        goals = tuple(Variable(f"held_goal_{j + 1}_rad", "rad") for j in range(self.dof))
        known, size = len(model.parameters), len(model.states)
        x, payload, h = ca.SX.sym("x", size), ca.SX.sym("payload"), ca.SX.sym("h")
        p = ca.SX.sym("p", known + size + self.dof)
        symbols = {"x": x, "u": payload, "p": p, "h": h}
        # The model's inputs are the goals and, last, the payload.
        of_model = symbols | {"u": ca.vertcat(p[known + size :], payload), "p": p[:known]}
        functions: dict[str, Any] = {}
        for what, labels in ARGUMENTS.items():
            if (function := getattr(model, what)) is not None:
                result = function(*(of_model[label] for label in labels))
                if what == "initial":
                    result = p[known : known + size]
                elif what == "output":
                    result = ca.vertcat(x, result)
                functions[what] = ca.Function(what, [symbols[label] for label in labels], [result])
        stepped = replace(
            model, name=f"{model.name}_one_step", inputs=(model.inputs[-1],),
            parameters=model.parameters + states + goals, outputs=model.states + model.outputs,
            **functions,
        )  # fmt: skip
        return CompiledModel(stepped, names(states + goals))
