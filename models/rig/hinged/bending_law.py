"""Bending torque of the hinges: elastic, relaxing and hysteretic.

All hinge pairs are computed at once. Every part is a torque against one measure of bend u,

    u = S skew(phi - phi_0),     tau = -(du/dphi)^T m(u, history),

so that for any `skew` (directional stiffness) and S (coupling of the planes) the power that the
law absorbs is m . du/dt and no part can create energy. m sums up, per hinge pair:

* a radial elastic torque K tanh(K|u| / M_c) / (K|u| / M_c) u that levels off at the limit moment;
* three Maxwell branches, ds/dt = g K du/dt - s / tau;
* biaxial Bouc-Wen friction kappa K u_y z, dz = du / u_y - (|z.du| + z.du) z / (2 u_y)
  (after Park, Wen and Ang, 1986 [recalled]), integrated implicitly in z.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from models.rig.rig_parameters import RigParameters
from models.shared.kinematics import Array

SPAN_HINGES: Final = 8
"""Hinge pairs of the span, one in the middle of each eighth; the root's pair comes before."""

REFERENCE_BEND_RAD: Final = 0.1
"""Bend (of the root, or of the whole span) at which softening and hardening are given."""

LEAK_TIME_S: Final = 10.0
"""Time over which the leaking fraction is given."""


class BendLaw:
    """Torque of all hinge pairs and its memory.

    Parameters
    ----------
    parameters : RigParameters
        Of the rig.
    step_s : float
        Integration step.

    Attributes
    ----------
    stiffness_nm_rad : ndarray, shape (9,)
        Of each hinge pair, root first; N·m/rad.
    """

    def __init__(self, parameters: RigParameters, step_s: float) -> None:
        p, hinges = parameters, SPAN_HINGES
        pressure = p["stiffness.pressure_pa"] / p["stiffness.reference_pressure_pa"]
        span_nm_rad = p["stiffness.bending_n_m2"] * hinges / p["link.length_m"]
        self.stiffness_nm_rad = pressure * np.array(
            [p["stiffness.root_nm_rad"], *[span_nm_rad] * hinges]
        )
        limit_nm = np.array(
            [p["stiffness.root_limit_nm"], *[p["stiffness.span_limit_nm"]] * hinges]
        )
        self._per_limit = self.stiffness_nm_rad / (pressure * limit_nm)
        yield_rad = np.array(
            [p["memory.root_yield_rad"], *[p["memory.span_yield_rad"] / hinges] * hinges]
        )
        self._per_yield = 1.0 / yield_rad[:, None]
        friction_nm = p["memory.hysteresis_share"] * self.stiffness_nm_rad * yield_rad
        self._friction_nm = friction_nm[:, None]
        self._rest_rad = np.zeros((hinges + 1, 2))
        self._rest_rad[1:, 0] = p["stiffness.prebend_rad"] / hinges
        self._skew = 0.5 * p["stiffness.directional_share"]
        self._rounding_rad = p["stiffness.directional_rounding"] * yield_rad[:, None]
        self._rounding_rad_squared = self._rounding_rad**2
        coupling = 0.5 * p["stiffness.coupling_share"]
        self._mix = np.array([[1.0, coupling], [coupling, 1.0]])
        self._coupled = coupling != 0.0
        per_reference = np.array([1.0, *[float(hinges)] * hinges]) / REFERENCE_BEND_RAD
        soft = p["stiffness.softening_share"]
        self._soft = soft / (1.0 - soft) * per_reference
        self._hard = p["stiffness.hardening_share"] * per_reference**2
        self._bend_dependent = bool(self._soft.any() or self._hard.any())
        self._kept_fraction = 1.0 - p["stiffness.leak_share"]

        times_s = np.array([p[f"memory.relaxation_{b}_s"] for b in (1, 2, 3)])
        fraction = p["memory.relaxing_share"] / len(times_s)
        self._decay = np.exp(-step_s / times_s)[:, None, None]
        # Exact for a bend that grows at a constant rate over the step.
        held = (times_s * -np.expm1(-step_s / times_s) / step_s)[:, None]
        self._branch_nm_rad = (fraction * held * self.stiffness_nm_rad)[:, :, None]

        self._branch_nm = np.zeros((len(times_s), hinges + 1, 2))
        self._z = np.zeros((hinges + 1, 2))
        self._bend = self.measure(np.zeros((hinges + 1, 2)))[0]

    def measure(self, angle_rad: Array) -> tuple[Array, Array]:
        """Measure of bend u and the diagonal of its derivative before mixing.

        Parameters
        ----------
        angle_rad : ndarray, shape (9, 2)
            Hinge angles towards +x and +y.

        Returns
        -------
        u, slope : ndarray, shape (9, 2)
        """
        phi = angle_rad - self._rest_rad
        root = np.sqrt(phi * phi + self._rounding_rad_squared)
        skewed = phi + self._skew * (root - self._rounding_rad)
        return self._mixed(skewed), 1.0 + self._skew * phi / root

    def _mixed(self, planes: Array) -> Array:
        """Both planes coupled; rows of shape (9, 2)."""
        return planes @ self._mix if self._coupled else planes

    def torque_nm(self, angle_rad: Array, leaking_s: float = 0.0) -> Array:
        """Advance the memory to these angles and compute the torque on the hinges.

        Parameters
        ----------
        angle_rad : ndarray, shape (9, 2)
            Hinge angles towards +x and +y, one integration step after the last call's.
        leaking_s : float
            Time since the pressure started to leak.

        Returns
        -------
        ndarray, shape (9, 2)
            Restoring torque in N·m.
        """
        u, slope = self.measure(angle_rad)
        du = u - self._bend
        self._bend = u
        branch_nm = self._branch_nm
        branch_nm *= self._decay
        branch_nm += self._branch_nm_rad * du
        along = self._z * du
        along = along[:, :1] + along[:, 1:]
        shed = 0.5 * self._per_yield * (np.abs(along) + along)
        self._z = (self._z + self._per_yield * du) / (1.0 + shed)

        size = u * u
        size = np.sqrt(size[:, 0] + size[:, 1]) + 1e-12
        level = size * self._per_limit
        secant = self.stiffness_nm_rad * np.tanh(level) / level
        if self._bend_dependent:
            secant = secant * (1.0 + self._hard * size * size) / (1.0 + self._soft * size)
        moment = secant[:, None] * u
        moment += branch_nm[0] + branch_nm[1] + branch_nm[2]
        moment += self._friction_nm * self._z
        if leaking_s:
            moment *= self._kept_fraction ** (leaking_s / LEAK_TIME_S)
        return -slope * self._mixed(moment)
