"""Bending torque of the hinges: elastic, relaxing and hysteretic.

All hinge pairs are computed at once. Every part is a torque against one measure of bend u,

    u = S skew(phi - phi_0),     tau = -(du/dphi)^T m(u, history),

so that for any `skew` (directional stiffness) and S (coupling of the planes) the power that the
law absorbs is m . du/dt and no part can create energy. m sums up, per hinge pair:

* a radial elastic torque K f(x) / x u, x = K|u| / M_c, that levels off at the limit moment M_c:
  f = tanh(x), or a box that wrinkles from half of M_c on, f = x, then 1 - 1 / (4 x) (wrinkling from
  half of the collapse moment: Comer and Levy, *AIAA Journal* 1, 1963 [recalled]; shape [assumed]);
* Maxwell branches, ds/dt = g K du/dt - s / tau (`models.rig.forms.creep_forms`);
* friction (`models.rig.forms.hysteresis_forms`).
"""

from __future__ import annotations

from typing import Final

import numpy as np

from models.rig.forms.creep_forms import relaxation_spectrum
from models.rig.forms.hysteresis_forms import hysteresis_form
from models.rig.rig_parameters import RigParameters
from models.shared.kinematics import Array

REFERENCE_BEND_RAD: Final = 0.1
"""Bend (of the root, or of the whole span) at which softening and hardening are given."""

LEAK_TIME_S: Final = 10.0
"""Time over which the leaking fraction is given."""


class BendLaw:
    """Torque of all n hinge pairs and its memory: the root's, then those of the span.

    Parameters
    ----------
    parameters : RigParameters
        Of the rig.
    step_s : float
        Integration step.

    Attributes
    ----------
    stiffness_nm_rad : ndarray, shape (n,)
        Of each hinge pair, root first; N·m/rad.
    """

    def __init__(self, parameters: RigParameters, step_s: float) -> None:
        p, hinges = parameters, parameters.structure.hinges
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
        self._hysteresis = hysteresis_form(p, yield_rad, self.stiffness_nm_rad)
        self._wrinkling = p.structure.limit == "wrinkling"
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

        times_s, fractions = relaxation_spectrum(p)
        self._decay = np.exp(-step_s / times_s)[:, None, None]
        # Exact for a bend that grows at a constant rate over the step.
        held = (times_s * -np.expm1(-step_s / times_s) / step_s)[:, None]
        self._branch_nm_rad = (fractions[:, None] * held * self.stiffness_nm_rad)[:, :, None]

        self._branch_nm = np.zeros((len(times_s), hinges + 1, 2))
        self._bend = self.measure(np.zeros((hinges + 1, 2)))[0]

    def measure(self, angle_rad: Array) -> tuple[Array, Array]:
        """Measure of bend u and the diagonal of its derivative before mixing.

        Parameters
        ----------
        angle_rad : ndarray, shape (n, 2)
            Hinge angles towards +x and +y.

        Returns
        -------
        u, slope : ndarray, shape (n, 2)
        """
        phi = angle_rad - self._rest_rad
        root = phi * phi
        root += self._rounding_rad_squared
        np.sqrt(root, out=root)
        skewed = root - self._rounding_rad
        skewed *= self._skew
        skewed += phi
        slope = self._skew * phi
        slope /= root
        slope += 1.0
        return self._mixed(skewed), slope

    def _mixed(self, planes: Array) -> Array:
        """Both planes coupled; rows of shape (n, 2)."""
        return planes @ self._mix if self._coupled else planes

    def torque_nm(self, angle_rad: Array, leaking_s: float = 0.0) -> Array:
        """Advance the memory to these angles and compute the torque on the hinges.

        Parameters
        ----------
        angle_rad : ndarray, shape (n, 2)
            Hinge angles towards +x and +y, one integration step after the last call's.
        leaking_s : float
            Time since the pressure started to leak.

        Returns
        -------
        ndarray, shape (n, 2)
            Restoring torque in N·m.
        """
        u, slope = self.measure(angle_rad)
        du = u - self._bend
        self._bend = u
        branch_nm = self._branch_nm
        branch_nm *= self._decay
        branch_nm += self._branch_nm_rad * du

        square = u * u
        size = square[:, 0] + square[:, 1]
        np.sqrt(size, out=size)
        size += 1e-12
        level = size * self._per_limit
        if self._wrinkling:
            level = np.maximum(level, 0.5)
            secant = self.stiffness_nm_rad * (1.0 - 0.25 / level) / level
        else:
            secant = self.stiffness_nm_rad * np.tanh(level) / level
        if self._bend_dependent:
            secant = secant * (1.0 + self._hard * size * size) / (1.0 + self._soft * size)
        moment = secant[:, None] * u
        relaxing = branch_nm[0] + branch_nm[1]
        for branch in branch_nm[2:]:
            relaxing += branch
        moment += relaxing
        moment += self._hysteresis.torque_nm(du)
        if leaking_s:
            moment *= self._kept_fraction ** (leaking_s / LEAK_TIME_S)
        return -slope * self._mixed(moment)
