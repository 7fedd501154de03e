"""Linearised twin: exact derivatives of one control period, as state space for python-control.

The twin rests at an angle. At rest dry friction is as stiff as its smoothing; in motion it does not
depend on the speed. Both are linearised: `sliding` leaves dry friction out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import casadi as ca
import control
import numpy as np
import scipy.linalg

from firmware_py.core.errors import InputError
from models.plant.step_model import Array, StepModel, names

DRY_FRICTION: Final = (
    "coulomb_friction_", "load_dependent_friction_", "stribeck_friction_", "stiction_",
)  # fmt: skip
"""Prefixes of the parameters that are 0 while the joints slide."""
STIFFNESS: Final = ("root_stiffness_", "span_stiffness_")
"""Prefixes of the parameters that scale with the stiffness of the link."""


class LinearTwins:
    """Linearisations of a link's twin at several payloads."""

    def __init__(self, model: StepModel, period_s: float) -> None:
        self.dof, self.period_s, self._model = len(model.inputs) - 1, period_s, model
        x, u = ca.MX.sym("x", len(model.states)), ca.MX.sym("u", len(model.inputs))
        p = ca.MX.sym("p", len(model.parameters))
        state, count = model.begin(x, u, p, period_s), model.substeps(period_s)
        for _ in range(count):
            state = model.flow(state, u, p, period_s / count)
        state = (model.smooth_finish or model.finish)(state, u, p, period_s)
        y = model.output(x, u, p)
        self._step = ca.Function("step", [x, u, p], [state]).expand()
        slopes = [ca.jacobian(f, v) for f in (state, y) for v in (x, u)]
        self._slopes = ca.Function("slopes", [x, u, p], slopes)

    def at(
        self,
        payload_kg: float,
        angles_rad: Array | None = None,
        *,
        sliding: bool = True,
        stiffness: float = 1.0,
    ) -> control.StateSpace:
        """Twin linearised about rest at goals of `angles_rad` (dof,), by default zero.

        `stiffness` is a factor on that of the link.
        """
        model, dof = self._model, self.dof
        changes = {v.name: stiffness * v.start for v in model.parameters
                   if v.name.startswith(STIFFNESS)}  # fmt: skip
        if sliding:
            dry = [n for n in names(model.parameters) if n.startswith(DRY_FRICTION)]
            changes |= dict.fromkeys(dry, 0.0)
        p = model.parameter_values(changes)
        u = np.append(np.zeros(dof) if angles_rad is None else angles_rad, payload_kg)
        x = np.asarray(model.initial(u, p)).ravel()
        for _ in range(200):
            settled = np.asarray(self._step(x, u, p)).ravel()
            if np.max(np.abs(settled - x)) < 1e-9:
                break
            x = settled
        a, b, c, d = (np.array(m, dtype=np.float64) for m in self._slopes(x, u, p))
        return control.ss(
            a, b[:, :dof], c, d[:, :dof], self.period_s, states=names(model.states),
            inputs=names(model.inputs)[:dof], outputs=names(model.outputs),
        )  # fmt: skip


def tip_part(system: control.StateSpace) -> control.StateSpace:
    """Part of a linearised twin from the goals to the planned coordinates of the tip."""
    rows = _tip_rows(system)
    return control.ss(system.A, system.B, system.C[rows], system.D[rows], system.dt)


def _tip_rows(system: control.StateSpace) -> list[int]:
    """Rows of the outputs that are planned: tip x, and y with two joints."""
    return [system.output_labels.index(f"tip_{axis}_m") for axis in "xy"[: system.ninputs]]


@dataclass(frozen=True)
class LinearMode:
    """Mode of a linearised twin."""

    frequency_rad_s: float  # Magnitude of its pole
    damping: float  # Damping ratio; 1 for a real pole
    # Part of the link's free bend that swings in this mode, along x, and y with two joints
    shares: tuple[float, ...] = ()

    @property
    def half_period_s(self) -> float:
        """Half of the period of the damped vibration."""
        return math.pi / (self.frequency_rad_s * math.sqrt(1.0 - self.damping**2))

    @property
    def decay(self) -> float:
        """Amplitude after half a period over that before."""
        return math.exp(-self.damping * self.frequency_rad_s * self.half_period_s)


def modes(system: control.StateSpace) -> list[LinearMode]:
    """Modes of a linearised twin below its Nyquist frequency, slowest first.

    The share of a mode is its part in the free motion of a link that is released from a bend. With
    left and right eigenvectors w and v, and the deflection c of the tip by the bends alone::

        share = 2 |c v| |w' c'| / (|w' v| c c')

    without the 2 for a real mode, which has no conjugate. That is the modal participation of
    Pérez-Arriaga, Verghese and Schweppe (*IEEE Trans. Power Apparatus and Systems* 101, 1982) of
    the deflection. The loop of the servo hardly bends the link, so its poles have little share,
    however slow and however lightly damped they are.
    """
    values, left, right = scipy.linalg.eig(system.A, left=True, right=True)
    bends = [n.startswith(("root_bend_", "span_bend_")) and n.endswith("_rad")
             for n in system.state_labels]  # fmt: skip
    deflection = np.where(bends, system.C[_tip_rows(system)], 0.0)
    overlap = np.abs(np.einsum("ik,ik->k", left.conj(), right))
    part = np.abs((deflection @ right) * (deflection @ left.conj()))
    size = np.sum(deflection**2, axis=1, keepdims=True)
    conjugates = np.where(np.abs(values.imag) > 0.0, 2.0, 1.0)
    shares = conjugates * part / np.maximum(overlap * size, 1e-12)
    alive = np.abs(values) > 1e-6
    rates = np.log(values[alive]) / system.dt
    all_modes = [
        LinearMode(float(abs(rate)), float(-rate.real / abs(rate)), tuple(part.tolist()))
        for rate, part in zip(rates, shares.T[alive], strict=True)
        if rate.imag >= 0 and 0.05 <= abs(rate) < np.pi / system.dt  # slower states do not move
    ]
    return sorted(all_modes, key=lambda mode: mode.frequency_rad_s)


def link_modes(system: control.StateSpace) -> list[LinearMode]:
    """First mode of the link along each planned axis: the vibration with the largest share.

    Its only share is that along the axis. The list is empty where nothing vibrates.
    """
    swings = [m for m in modes(system) if m.damping < 1.0]
    first = []
    for axis in range(system.ninputs if swings else 0):
        best = max(swings, key=lambda m: m.shares[axis])
        w = best.frequency_rad_s
        # The planes of a link of two joints have the same modes, and any combination of two such
        # vectors is an eigenvector: the shares of modes of one frequency add up.
        alike = (m.shares[axis] for m in swings if abs(m.frequency_rad_s - w) < 0.1 * w)
        first.append(LinearMode(w, best.damping, (min(1.0, sum(alike)),)))
    return first


def resting_modes(
    twins: LinearTwins, payload_kg: float, angles_rad: Array | None = None
) -> list[LinearMode]:
    """First mode of the link along each axis while the joints stand; refused if there is none."""
    first = link_modes(twins.at(payload_kg, angles_rad, sliding=False))
    if not first:
        raise InputError(
            "the plant", f"has no vibration with {payload_kg:g} kg", "name a plant that was "
            "identified on a link that swings",
        )  # fmt: skip
    return first
