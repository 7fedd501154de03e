"""Linearised twin: exact derivatives of one control period, as state space for python-control.

The twin rests at an angle. At rest dry friction is as stiff as its smoothing; in motion it does not
depend on the speed. Both are linearised: `sliding` leaves dry friction out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import casadi as ca
import control
import numpy as np
from numpy.typing import NDArray

from models.plant.plant import Plant
from models.plant.step_model import names

Array = NDArray[np.float64]
DRY_FRICTION: Final = (
    "coulomb_friction_", "load_dependent_friction_", "stribeck_friction_", "stiction_",
)  # fmt: skip
"""Prefixes of the parameters that are 0 while the joints slide."""
STIFFNESS: Final = ("root_stiffness_", "span_stiffness_")
"""Prefixes of the parameters that scale with the stiffness of the link."""
_SETTLE_STEPS: Final = 200


@dataclass(frozen=True)
class LinearMode:
    """Mode of a linearised twin."""

    frequency_rad_s: float  # Magnitude of its pole
    damping: float  # Damping ratio; 1 for a real pole


class LinearTwins:
    """Linearisations of a plant's twin over one control period."""

    def __init__(self, plant: Plant, dof: int, period_s: float) -> None:
        model = plant.step_model(dof)
        self.dof, self.period_s, self._model = dof, period_s, model
        x, u = ca.MX.sym("x", len(model.states)), ca.MX.sym("u", len(model.inputs))
        p = ca.MX.sym("p", len(model.parameters))
        state, count = model.begin(x, u, p, period_s), model.substeps(period_s)
        for _ in range(count):
            state = model.flow(state, u, p, period_s / count)
        state = (model.smooth_finish or model.finish)(state, u, p, period_s)
        y = model.output(x, u, p)
        self._step = ca.Function("step", [x, u, p], [state]).expand()
        self._slopes = ca.Function(
            "slopes", [x, u, p],
            [ca.jacobian(f, v) for f in (state, y) for v in (x, u)],
        )  # fmt: skip

    def at(
        self, payload_kg: float, angles_rad: Array | None = None, *, sliding: bool = True,
        stiffness: float = 1.0,
    ) -> control.StateSpace:  # fmt: skip
        """Twin linearised about rest, with goals as inputs; names carry units.

        `sliding`: whether dry friction is left out, as while the joints move. Shapes: `angles_rad`
        (dof,).
        """
        model, dof = self._model, self.dof
        p = model.parameter_values(self._changes(sliding, stiffness))
        u = np.append(np.zeros(dof) if angles_rad is None else angles_rad, payload_kg)
        x = np.asarray(model.initial(u, p)).ravel()
        for _ in range(_SETTLE_STEPS):
            settled = np.asarray(self._step(x, u, p)).ravel()
            if np.max(np.abs(settled - x)) < 1e-9:
                break
            x = settled
        a, b, c, d = (np.array(m, dtype=np.float64) for m in self._slopes(x, u, p))
        return control.ss(
            a, b[:, :dof], c, d[:, :dof], self.period_s, states=names(model.states),
            inputs=names(model.inputs)[:dof], outputs=names(model.outputs),
        )  # fmt: skip

    def _changes(self, sliding: bool, stiffness: float) -> dict[str, float]:
        changes: dict[str, float] = {}
        for v in self._model.parameters:
            if sliding and v.name.startswith(DRY_FRICTION):
                changes[v.name] = 0.0
            if v.name.startswith(STIFFNESS):
                changes[v.name] = stiffness * v.start
        return changes


def tip_part(system: control.StateSpace, dof: int) -> control.StateSpace:
    """Part of a linearised twin from the goals to the planned coordinates of the tip."""
    rows = [system.output_labels.index(n) for n in ("tip_x_m", "tip_y_m")[:dof]]
    return control.ss(system.A, system.B, system.C[rows], system.D[rows], system.dt)


def frequency_response(system: control.StateSpace, rates_rad_s: Array) -> NDArray[np.complex128]:
    """Frequency response of a sampled system, shape (n, outputs, inputs).

    Shapes: `rates_rad_s` (n,).
    """
    z = np.exp(1j * rates_rad_s * system.dt)
    eye = np.eye(len(system.A))
    inner = np.linalg.solve(z[:, None, None] * eye - system.A, system.B.astype(complex)[None])
    return np.asarray(system.C @ inner + system.D)


SLOWEST_RAD_S: Final = 0.05
"""Least rate of a mode: slower poles are states that do not move."""


def modes(system: control.StateSpace) -> list[LinearMode]:
    """Modes of a sampled system below its Nyquist frequency, slowest first."""
    poles = np.linalg.eigvals(system.A)
    rates = np.log(poles[np.abs(poles) > 1e-6].astype(complex)) / system.dt
    found = [
        LinearMode(float(abs(s)), float(-s.real / abs(s)))
        for s in rates
        if s.imag >= 0 and SLOWEST_RAD_S <= abs(s) < np.pi / system.dt
    ]
    return sorted(found, key=lambda mode: mode.frequency_rad_s)
