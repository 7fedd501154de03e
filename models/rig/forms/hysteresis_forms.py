"""Friction of the link's skin: Bouc-Wen, Dahl or Maxwell slip, in two planes.

Each section has a yield bend u_y and a torque T = kappa K u_y. A small bend du from rest gives the
torque T du / u_y = kappa K du in every form, so a strength is the same fraction of the stiffness.
A form stores energy in a spring and dissipates it in a slider, so no path can draw energy from it:

* Bouc-Wen, dz = du / u_y - (|z.du| + z.du) z / (2 u_y) (after Park, Wen and Ang, 1986 [recalled]);
* Dahl, dz = du / u_y - |du| z / u_y (Dahl, 1968; exponent 1, in two planes);
* Maxwell slip, springs of equal stiffness with sliders of different yields in parallel (Iwan,
  *J. Applied Mechanics* 33, 1966 [recalled]); a spring beyond its yield is returned radially.

z is integrated implicitly. A form is one step in CasADi expressions
(`models.rig.hinged.bending_law`); both planes of n sections have the shape (2, n).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import casadi as ca
import numpy as np

from models.rig.rig_parameters import RigParameters
from models.shared.kinematics import Array


def both_planes(row: Any) -> Any:
    """Repeat one number per section to the shape (2, n)."""
    row = ca.DM(row).T if isinstance(row, np.ndarray) else row
    return ca.repmat(row, 2, 1)


def _length(planes: Any) -> Any:
    """Length of the vector of each section, shape (1, n)."""
    return ca.sqrt(planes[0, :] ** 2 + planes[1, :] ** 2)


class HysteresisForm(Protocol):
    """Friction of n sections."""

    springs: int  # Number of state arrays, each of shape (2, n); zero when relaxed

    def advanced(self, memory: Sequence[Any], du: Any) -> tuple[list[Any], Any]:
        """State, and torque in N·m, after a further bend `du` in rad of shape (2, n)."""
        ...


class BoucWen:
    """Bouc-Wen friction; arguments have shape (n,)."""

    springs = 1

    def __init__(self, yield_rad: Array, friction_nm: Array) -> None:
        self._yield_rad, self._friction_nm = yield_rad, friction_nm

    def advanced(self, memory: Sequence[Any], du: Any) -> tuple[list[Any], Any]:
        (z,) = memory
        along = z[0, :] * du[0, :] + z[1, :] * du[1, :]
        shed = 1.0 + (ca.fabs(along) + along) * ca.DM(0.5 / self._yield_rad).T
        z = (z + both_planes(1.0 / self._yield_rad) * du) / both_planes(shed)
        return [z], both_planes(self._friction_nm) * z


class Dahl:
    """Dahl friction; arguments have shape (n,)."""

    springs = 1

    def __init__(self, yield_rad: Array, friction_nm: Array) -> None:
        self._yield_rad, self._friction_nm = yield_rad, friction_nm

    def advanced(self, memory: Sequence[Any], du: Any) -> tuple[list[Any], Any]:
        (z,) = memory
        shed = 1.0 + _length(du) * ca.DM(1.0 / self._yield_rad).T
        z = (z + both_planes(1.0 / self._yield_rad) * du) / both_planes(shed)
        return [z], both_planes(self._friction_nm) * z


class MaxwellSlip:
    """Parallel springs with sliders; arguments have shape (n,), and `yields` (m,) is relative."""

    def __init__(self, yield_rad: Array, friction_nm: Array, yields: Array) -> None:
        self.springs = len(yields)
        self._slips_rad = yields[:, None] * yield_rad
        self._stiffness = friction_nm / yield_rad / len(yields)

    def advanced(self, memory: Sequence[Any], du: Any) -> tuple[list[Any], Any]:
        after = []
        for stretch, slip_rad in zip(memory, self._slips_rad, strict=True):
            stretched, slip = stretch + du, ca.DM(slip_rad).T
            after.append(stretched * both_planes(slip / ca.fmax(_length(stretched), slip)))
        return after, both_planes(self._stiffness) * sum(after)


def hysteresis_form(
    parameters: RigParameters, yield_rad: Array, stiffness_nm_rad: Array
) -> HysteresisForm:
    """Build the form that the structure names, relaxed; arguments have shape (n,)."""
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
