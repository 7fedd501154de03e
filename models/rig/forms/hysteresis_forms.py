"""Friction of the link's skin: Bouc-Wen, Dahl or Maxwell slip, in two planes.

Each section has a yield bend u_y and a torque T = kappa K u_y. A small bend du from rest gives the
torque T du / u_y = kappa K du in every form, so a strength is the same fraction of the stiffness.
A form stores energy in a spring and loses it in a slider, so that no path draws energy from it:

* Bouc-Wen, dz = du / u_y - (|z.du| + z.du) z / (2 u_y) (after Park, Wen and Ang, 1986 [recalled]);
* Dahl, dz = du / u_y - |du| z / u_y (Dahl, 1968; exponent 1, in two planes);
* Maxwell slip, springs of equal stiffness with sliders of different yields in parallel (Iwan,
  *J. Applied Mechanics* 33, 1966 [recalled]); a spring beyond its yield is drawn back radially.

z is integrated implicitly.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from models.rig.rig_parameters import RigParameters
from models.shared.kinematics import Array


class HysteresisForm(Protocol):
    """Friction of n sections with its memory."""

    def torque_nm(self, du: Array) -> Array:
        """Torque in N·m after a further bend `du` in rad, both of shape (n, 2)."""
        ...


class BoucWen:
    """Bouc-Wen friction.

    Parameters
    ----------
    yield_rad, friction_nm : ndarray, shape (n,)
        Yield bend and torque of each section.
    """

    def __init__(self, yield_rad: Array, friction_nm: Array) -> None:
        self._per_yield = 1.0 / yield_rad[:, None]
        self._half_per_yield = 0.5 * self._per_yield
        self._friction_nm = friction_nm[:, None]
        self._z = np.zeros((len(yield_rad), 2))

    def torque_nm(self, du: Array) -> Array:
        """See `HysteresisForm`."""
        z = self._z
        along = z * du
        along = along[:, :1] + along[:, 1:]
        shed = np.abs(along)
        shed += along
        shed *= self._half_per_yield
        shed += 1.0
        z += self._per_yield * du
        z /= shed
        return np.asarray(self._friction_nm * z)


class Dahl:
    """Dahl friction; parameters as `BoucWen`."""

    def __init__(self, yield_rad: Array, friction_nm: Array) -> None:
        self._per_yield = 1.0 / yield_rad[:, None]
        self._friction_nm = friction_nm[:, None]
        self._z = np.zeros((len(yield_rad), 2))

    def torque_nm(self, du: Array) -> Array:
        """See `HysteresisForm`."""
        path = np.sqrt(du[:, :1] ** 2 + du[:, 1:] ** 2)
        self._z = (self._z + self._per_yield * du) / (1.0 + self._per_yield * path)
        return np.asarray(self._friction_nm * self._z)


class MaxwellSlip:
    """Springs with sliders in parallel.

    Parameters
    ----------
    yield_rad, friction_nm : ndarray, shape (n,)
        Mean yield bend and torque of each section.
    yields : ndarray, shape (m,)
        Yield of each slider over the mean.
    """

    def __init__(self, yield_rad: Array, friction_nm: Array, yields: Array) -> None:
        self._slip_rad = (yields[:, None] * yield_rad)[:, :, None]
        self._stiffness = (friction_nm / yield_rad / len(yields))[:, None]
        self._stretch = np.zeros((len(yields), len(yield_rad), 2))

    def torque_nm(self, du: Array) -> Array:
        """See `HysteresisForm`."""
        stretch = self._stretch + du
        size = np.sqrt(stretch[:, :, :1] ** 2 + stretch[:, :, 1:] ** 2)
        self._stretch = stretch * (self._slip_rad / np.maximum(size, self._slip_rad))
        return np.asarray(self._stiffness * self._stretch.sum(axis=0))


def hysteresis_form(
    parameters: RigParameters, yield_rad: Array, stiffness_nm_rad: Array
) -> HysteresisForm:
    """Build the form that the structure names, at ease.

    Parameters
    ----------
    parameters : RigParameters
        Of the rig.
    yield_rad : ndarray, shape (n,)
        Bend at which a section's friction is mobilised.
    stiffness_nm_rad : ndarray, shape (n,)
        Of each section.
    """
    p = parameters
    friction_nm = p["memory.hysteresis_share"] * stiffness_nm_rad * yield_rad
    match p.structure.hysteresis:
        case "bouc_wen":
            return BoucWen(yield_rad, friction_nm)
        case "dahl":
            return Dahl(yield_rad, friction_nm)
        case "maxwell_slip":
            yields = np.geomspace(1.0, p["memory.slip_range"], round(p["memory.slip_elements"]))
            return MaxwellSlip(yield_rad, friction_nm, yields / yields.mean())
