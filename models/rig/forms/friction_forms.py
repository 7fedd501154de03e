"""Friction of the servo: a LuGre bristle, or a smooth function of the rate.

Both have the same level g (`models.rig.rig_servo`) and viscous term B:

* LuGre (Canudas de Wit et al., 1995 [recalled]), dz/dt = w - sigma_0 |w| z / g,
  F = sigma_0 z + sigma_1 dz/dt + B w, with z implicit, so that |sigma_0 z| never exceeds g;
* smooth, F = g w / sqrt(w^2 + w_0^2) + B w (shape [assumed]): it has no presliding, and a load
  below g moves it slowly. The factor of w is that at the start of the step and w that at its end,
  so friction never drives the rotor.
"""

from __future__ import annotations

import math
from typing import Protocol

from models.rig.rig_parameters import RigParameters


class FrictionForm(Protocol):
    """Friction of one servo, with its state."""

    def torque_nm(self, rate_rad_s: float, level_nm: float, drive_nm: float) -> float:
        """Advance by one step; return the torque against the motion in N·m."""
        ...


class LugreFriction:
    """LuGre bristle; equation in the module's docstring."""

    def __init__(self, parameters: RigParameters, step_s: float) -> None:
        self._step_s = step_s
        self._viscous = parameters["servo.viscous_friction_nm_s_rad"]
        self._bristle = parameters["servo.bristle_stiffness_nm_rad"]
        self._bristle_damping = parameters["servo.bristle_damping_nm_s_rad"]
        self._bristle_rad = 0.0

    def torque_nm(self, rate_rad_s: float, level_nm: float, drive_nm: float) -> float:
        before = self._bristle_rad
        shed = self._step_s * abs(rate_rad_s) * self._bristle / max(level_nm, 1e-9)
        self._bristle_rad = (before + self._step_s * rate_rad_s) / (1.0 + shed)
        bristle_rate = (self._bristle_rad - before) / self._step_s
        return (
            self._bristle * self._bristle_rad
            + self._bristle_damping * bristle_rate
            + self._viscous * rate_rad_s
        )


class SmoothFriction:
    """Smooth function of the rate; equation in the module's docstring."""

    def __init__(self, parameters: RigParameters, step_s: float) -> None:
        self._step_per_inertia = step_s / parameters["servo.inertia_kg_m2"]
        self._viscous = parameters["servo.viscous_friction_nm_s_rad"]
        self._rate_0 = parameters["servo.smooth_rate_rad_s"]

    def torque_nm(self, rate_rad_s: float, level_nm: float, drive_nm: float) -> float:
        factor = level_nm / math.hypot(rate_rad_s, self._rate_0) + self._viscous
        free = rate_rad_s + self._step_per_inertia * drive_nm
        return factor * free / (1.0 + self._step_per_inertia * factor)


def friction_form(parameters: RigParameters, step_s: float) -> FrictionForm:
    """Build the form that the structure names."""
    if parameters.structure.friction == "lugre":
        return LugreFriction(parameters, step_s)
    return SmoothFriction(parameters, step_s)
