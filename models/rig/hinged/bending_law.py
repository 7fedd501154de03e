"""Bending torque of the hinges: elastic, relaxing and hysteretic.

All hinge pairs are computed at once. Every part is a torque against one measure of bend u,

    u = S skew(phi - phi_0),     tau = -(du/dphi)^T m(u, history),

so for any `skew` (directional stiffness) and S (coupling of the planes) the law absorbs the power
m . du/dt, and no part can create energy. m is the sum, per hinge pair, of

* a radial elastic torque K f(x) / x u, x = K|u| / M_c, that saturates at the limit moment M_c:
  f = tanh(x), or a wall that wrinkles above half of M_c, f = x, then 1 - 1 / (4 x) (half of the
  collapse moment is a tube's: Comer and Levy, *AIAA Journal* 1, 1963 [recalled]; that a box has
  half, not two thirds as in docs/sources.md, "The link", and the shape are [assumed]);
* Maxwell branches, ds/dt = g K du/dt - s / tau (`models.rig.forms.creep_forms`);
* friction (`models.rig.forms.hysteresis_forms`).

One CasADi function advances all pairs: an integration step is about a thousand operations on a few
numbers each, for which NumPy would need most of its time in calls. Both planes of n pairs are a
matrix of shape (2, n); CasADi stores it by columns, as NumPy stores the shape (n, 2) by rows.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from models.rig.forms.creep_forms import relaxation_spectrum
from models.rig.forms.hysteresis_forms import both_planes, hysteresis_form
from models.rig.hinged.in_place_function import InPlaceFunction
from models.rig.rig_parameters import RigParameters
from models.shared.catalogue import LEAK_TIME_S, REFERENCE_BEND_RAD
from models.shared.kinematics import Array


class BendLaw:
    """Torque of all n hinge pairs, the root's first, and the state of their memory."""

    def __init__(self, parameters: RigParameters, step_s: float) -> None:
        p, hinges = parameters, parameters.structure.hinges
        self._p, self._step_s, self._pairs = p, step_s, hinges + 1
        self._pressure = p["stiffness.pressure_pa"] / p["stiffness.reference_pressure_pa"]
        span_nm_rad = p["stiffness.bending_n_m2"] * hinges / p["link.length_m"]
        self.stiffness_nm_rad = self._pressure * np.array(
            [p["stiffness.root_nm_rad"], *[span_nm_rad] * hinges]
        )
        self._yield_rad = np.array(
            [p["memory.root_yield_rad"], *[p["memory.span_yield_rad"] / hinges] * hinges]
        )
        self._kept_fraction = 1.0 - p["stiffness.leak_share"]
        self._connect(self._advance())

    def torque_nm(self, angle_rad: Array, leaking_s: float = 0.0) -> Array:
        """Advance the memory to these angles and return the restoring torque in N·m, shape (n, 2).

        `angle_rad` (n, 2) are the hinge angles towards +x and +y, one step after the last call.
        """
        self._angle_rad[:] = angle_rad.ravel()
        if leaking_s:
            self._kept[0] = self._kept_fraction ** (leaking_s / LEAK_TIME_S)
        self._evaluate()
        self._memory[:] = self._memory_after
        return self._torque_nm.copy()

    def _connect(self, advance: ca.Function) -> None:
        """Bind the function to its arrays; the link is relaxed at zero."""
        self._angle_rad, self._kept = np.zeros(2 * self._pairs), np.ones(1)
        self._memory, self._memory_after = np.zeros((2, advance.numel_in(1)))
        at_zero = self._measure(ca.DM.zeros(2, self._pairs))[0].full()
        self._memory[: at_zero.size] = at_zero.T.flat
        self._torque_nm = np.zeros((self._pairs, 2))
        self._evaluate = InPlaceFunction(
            advance,
            [self._angle_rad, self._memory, self._kept],
            [self._torque_nm, self._memory_after],
        )

    def _advance(self) -> ca.Function:
        """Function (angles, memory, remaining pressure) -> (torque, memory after the step)."""
        p, n = self._p, self._pairs
        times_s, fractions = relaxation_spectrum(p)
        hysteresis = hysteresis_form(p, self._yield_rad, self.stiffness_nm_rad)
        angle_rad = ca.SX.sym("angle_rad", 2, n)
        u_before = ca.SX.sym("u", 2, n)
        branches_nm = [ca.SX.sym("branch_nm", 2, n) for _ in times_s]
        slid = [ca.SX.sym("slid", 2, n) for _ in range(hysteresis.springs)]
        kept = ca.SX.sym("kept")

        u, slope = self._measure(angle_rad)
        du = u - u_before
        decays = np.exp(-self._step_s / times_s)
        # Exact for a bend that grows at a constant rate over the step.
        held = fractions * times_s * -np.expm1(-self._step_s / times_s) / self._step_s
        relaxed_nm = [
            decay * branch_nm + both_planes(share * self.stiffness_nm_rad) * du
            for decay, share, branch_nm in zip(decays, held, branches_nm, strict=True)
        ]
        slid_after, friction_nm = hysteresis.advanced(slid, du)
        moment_nm = both_planes(self._secant_nm_rad(u)) * u + sum(relaxed_nm) + friction_nm
        torque_nm = -kept * slope * self._mixed(moment_nm)
        memory = [u_before, *branches_nm, *slid]
        memory_after = [u, *relaxed_nm, *slid_after]
        return ca.Function(
            "advance",
            [angle_rad, _stacked(memory), kept],
            [torque_nm, _stacked(memory_after)],
        )

    def _measure(self, angle_rad: Any) -> tuple[Any, Any]:
        """Measure of bend u and the diagonal of its derivative before coupling, shape (2, n)."""
        p, hinges = self._p, self._pairs - 1
        rest_rad = np.zeros((2, self._pairs))
        rest_rad[0, 1:] = p["stiffness.prebend_rad"] / hinges
        skew = 0.5 * p["stiffness.directional_share"]
        rounding_rad = both_planes(p["stiffness.directional_rounding"] * self._yield_rad)
        phi = angle_rad - rest_rad
        root = ca.sqrt(phi**2 + rounding_rad**2)
        return self._mixed(phi + skew * (root - rounding_rad)), 1.0 + skew * phi / root

    def _mixed(self, planes: Any) -> Any:
        """Couple both planes; shape (2, n)."""
        coupling = 0.5 * self._p["stiffness.coupling_share"]
        return ca.DM([[1.0, coupling], [coupling, 1.0]]) @ planes

    def _secant_nm_rad(self, u: Any) -> Any:
        """Radial elastic torque over the bend, shape (1, n)."""
        p, hinges = self._p, self._pairs - 1
        stiffness_nm_rad = ca.DM(self.stiffness_nm_rad).T
        limit_nm = np.array(
            [p["stiffness.root_limit_nm"], *[p["stiffness.span_limit_nm"]] * hinges]
        )
        size = ca.sqrt(u[0, :] ** 2 + u[1, :] ** 2) + 1e-12
        level = size * ca.DM(self.stiffness_nm_rad / (self._pressure * limit_nm)).T
        if p.structure.limit == "wrinkling":
            level = ca.fmax(level, 0.5)
            secant = stiffness_nm_rad * (1.0 - 0.25 / level) / level
        else:
            secant = stiffness_nm_rad * ca.tanh(level) / level
        per_reference = np.array([1.0, *[float(hinges)] * hinges]) / REFERENCE_BEND_RAD
        soft = p["stiffness.softening_share"]
        softer = ca.DM(soft / (1.0 - soft) * per_reference).T
        harder = ca.DM(p["stiffness.hardening_share"] * per_reference**2).T
        return secant * (1.0 + harder * size**2) / (1.0 + softer * size)


def _stacked(parts: list[Any]) -> Any:
    return ca.vertcat(*[ca.vec(part) for part in parts])
