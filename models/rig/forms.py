"""Spectrum of the link's relaxation: three branches, or a power law of time.

A power law is that of a fractional element, whose spectrum of relaxation times falls as tau^-alpha
per decade (Mainardi, *Fractional Calculus and Waves in Linear Viscoelasticity*, 2010 [recalled]);
it has one branch per half decade here. Both spectra sum up to the relaxing fraction.

Friction of the link's skin: Bouc-Wen, Dahl or Maxwell slip, in two planes.

Each section has a yield bend u_y and a torque T = kappa K u_y. A small bend du from rest gives the
torque T du / u_y = kappa K du in every form, so a strength is the same fraction of the stiffness.
A form stores energy in a spring and dissipates it in a slider, so no path can draw energy from it:

* Bouc-Wen, dz = du / u_y - (|z.du| + z.du) z / (2 u_y) (after Park, Wen and Ang, 1986 [recalled]);
* Dahl, dz = du / u_y - |du| z / u_y (Dahl, 1968; exponent 1, in two planes);
* Maxwell slip, springs of equal stiffness with sliders of different yields in parallel (Iwan,
  *J. Applied Mechanics* 33, 1966 [recalled]); a spring beyond its yield is returned radially.

z is integrated implicitly. A form is one step in CasADi expressions
(`models.rig.hinged`); both planes of n sections have the shape (2, n).

Friction of the servo: a LuGre bristle, or a smooth function of the rate.

Both have the same level g (`models.rig.servo`) and viscous term B:

* LuGre (Canudas de Wit et al., 1995 [recalled]), dz/dt = w - sigma_0 |w| z / g,
  F = sigma_0 z + sigma_1 dz/dt + B w, with z implicit, so that |sigma_0 z| never exceeds g;
* smooth, F = g w / sqrt(w^2 + w_0^2) + B w (shape [assumed]): it has no presliding, and a load
  below g moves it slowly. The factor of w is that at the start of the step and w that at its end,
  so friction never drives the rotor.

Set-point of the servo between two goals: held, interpolated or profiled.

A held goal becomes the set-point at once. An interpolating servo reaches the goal on a line, one
control period after it took effect. A profiling servo moves its set-point with limited velocity and
acceleration (trapezoidal profile, e-Manual of ROBOTIS, "Profile Velocity"). It plans again from the
current set-point when the next goal arrives.

Current that the servo's register holds when the robot reads it.

It is sampled at the tick, at a phase of the period before, or averaged over that period: servos
read and filter their current in a cycle of their own.

Play in the link's mount, which moves only the markers.

The link leans by half of the play to the side that its torque pushes to. It moves from one side to
the other within a small range of torque and a short time.

Filter of the motion capture's software over its frames: none, causal, or zero-phase.

Butterworth filters of second order (Butterworth, *Wireless Engineer* 7, 1930 [recalled]): forward
once, as in a live stream, or forward and backward, as software filters a recording (Winter,
*Biomechanics and Motor Control of Human Movement* [recalled]), with a response of one half at the
cut-off.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import casadi as ca
import numpy as np

from firmware_py.signals import PERIOD_S
from models.rig.parameters import RigParameters
from models.shared.kinematics import Array


class RelaxationSpectrum(NamedTuple):
    """Maxwell branches: times in s and fractions of the stiffness, shape (n,) each."""

    times_s: Array
    fractions: Array


def relaxation_spectrum(parameters: RigParameters) -> RelaxationSpectrum:
    """Build the spectrum that the structure names."""
    p = parameters
    relaxing = p["memory.relaxing_share"]
    if p.structure.creep == "branches":
        times_s = np.array([p[f"memory.relaxation_{b}_s"] for b in (1, 2, 3)])
        return RelaxationSpectrum(times_s, np.full(len(times_s), relaxing / len(times_s)))
    shortest_s, longest_s = p["memory.power_shortest_s"], p["memory.power_longest_s"]
    count = 1 + round(2.0 * np.log10(longest_s / shortest_s))
    times_s = np.geomspace(shortest_s, longest_s, count)
    weights = times_s ** -p["memory.power_exponent"]
    return RelaxationSpectrum(times_s, relaxing * weights / weights.sum())


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


class GoalForm(Protocol):
    """Set-point of one servo, at rest at zero."""

    # Rate of the set-point in the last step; for a held goal, its last change per period
    rate_rad_s: float

    def take(self, goal_rad: float) -> None:
        """Set the goal that takes effect now."""
        ...

    def advance(self) -> float:
        """Advance by one step and return the set-point in rad."""
        ...


class HeldGoal:
    """Set-point that jumps to each goal."""

    def __init__(self, step_s: float) -> None:
        self._steps = max(round(PERIOD_S / step_s), 1)
        self._goal_rad = self._change_rad = self.rate_rad_s = 0.0
        self._left = 0

    def take(self, goal_rad: float) -> None:
        self._change_rad, self._left = goal_rad - self._goal_rad, self._steps
        self._goal_rad = goal_rad

    def advance(self) -> float:
        self.rate_rad_s = self._change_rad / PERIOD_S if self._left else 0.0
        self._left = max(self._left - 1, 0)
        return self._goal_rad


class InterpolatedGoal:
    """Set-point that moves to each goal on a line."""

    def __init__(self, step_s: float) -> None:
        self._steps = max(round(PERIOD_S / step_s), 1)
        self._step_s = step_s
        self._goal_rad = self._setpoint_rad = self._per_step_rad = self.rate_rad_s = 0.0
        self._left = 0

    def take(self, goal_rad: float) -> None:
        self._goal_rad, self._left = goal_rad, self._steps
        self._per_step_rad = (goal_rad - self._setpoint_rad) / self._steps

    def advance(self) -> float:
        self.rate_rad_s = self._per_step_rad / self._step_s if self._left else 0.0
        if self._left:
            self._left -= 1
            self._setpoint_rad = self._goal_rad - self._left * self._per_step_rad
        return self._setpoint_rad


class ProfiledGoal:
    """Set-point that moves with limited velocity and acceleration."""

    def __init__(self, step_s: float, velocity_rad_s: float, acceleration_rad_s2: float) -> None:
        self._step_s = step_s
        self._fastest = velocity_rad_s
        self._gain = acceleration_rad_s2 * step_s  # of velocity in a step
        self._goal_rad = self._setpoint_rad = self.rate_rad_s = 0.0

    def take(self, goal_rad: float) -> None:
        self._goal_rad = goal_rad

    def advance(self) -> float:
        left = self._goal_rad - self._setpoint_rad
        # With n steps of braking from the velocity n a h, the distance is a h^2 n (n + 1) / 2.
        steps = math.sqrt(0.25 + 2.0 * abs(left) / (self._gain * self._step_s)) - 0.5
        speed = min(self._gain * steps, abs(left) / self._step_s, self._fastest)
        wanted = math.copysign(speed, left)
        slowest, fastest = self.rate_rad_s - self._gain, self.rate_rad_s + self._gain
        self.rate_rad_s = min(max(wanted, slowest), fastest)
        self._setpoint_rad += self._step_s * self.rate_rad_s
        return self._setpoint_rad


def goal_form(parameters: RigParameters, step_s: float) -> GoalForm:
    """Build the form that the structure names."""
    p = parameters
    match p.structure.goal:
        case "held":
            return HeldGoal(step_s)
        case "interpolated":
            return InterpolatedGoal(step_s)
        case "profile":
            velocity, acceleration = (
                p["servo.profile_velocity_rad_s"], p["servo.profile_acceleration_rad_s2"],
            )  # fmt: skip
            return ProfiledGoal(step_s, velocity, acceleration)


class CurrentRegister:
    """Samples of the current over the last control period."""

    def __init__(self, parameters: RigParameters, step_s: float) -> None:
        sampling = parameters.structure.current_sampling
        steps = PERIOD_S / step_s
        kept = {"tick": 0.0, "phase": parameters["sensor.current_phase"] * steps, "mean": steps - 1}
        self._mean = sampling == "mean"
        self._window: deque[float] = deque([0.0], maxlen=round(kept[sampling]) + 1)
        self.hold = self._window.append
        """Call it with the current in A after each step."""

    @property
    def value_a(self) -> float:
        """Current in A that the register holds."""
        if self._mean:
            return sum(self._window) / len(self._window)
        return self._window[0]


class MarkerPlay:
    """Lean of the link in its mount, at first in the middle; zero if the play is in the gear."""

    def __init__(self, parameters: RigParameters, dof: int, step_s: float) -> None:
        p, in_markers = parameters, parameters.structure.play == "markers"
        own_rad = [p.of_joint(k + 1)["servo.backlash_rad"] for k in range(dof)]
        self._half_rad = [0.5 * width if in_markers else 0.0 for width in own_rad]
        self.absent = not any(self._half_rad)
        self._torque_nm = p["servo.play_torque_nm"]
        self._gain = -math.expm1(-step_s / p["servo.play_time_s"])
        self.lean_rad = np.zeros(dof)

    def advance(self, torque_nm: Sequence[float]) -> None:
        """Advance by one step; `torque_nm` acts from the drives on the joints."""
        for k, (torque, half_rad) in enumerate(zip(torque_nm, self._half_rad, strict=True)):
            side_rad = -half_rad * math.tanh(torque / self._torque_nm)
            self.lean_rad[k] += self._gain * (side_rad - self.lean_rad[k])

    def shown_m(self, markers_m: Array, joint_rad: Sequence[float]) -> Array:
        """Markers on the leaning link, shape (markers, 3)."""
        cos, sin = math.cos(joint_rad[0]), math.sin(joint_rad[0])
        # Rotation vector; the second axis, -x, is carried by the first joint.
        x, y, z = 0.0, self.lean_rad[0], 0.0
        if len(self.lean_rad) == 2:
            x, z = -cos * self.lean_rad[1], sin * self.lean_rad[1]
        turn = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        return np.asarray(markers_m + markers_m @ (turn + 0.5 * turn @ turn).T)


def filtered_frames(parameters: RigParameters, frames_m: Array) -> Array:
    """Frames after the software's filter, shape (n, markers, 3), at the motion capture's rate.

    The link is at rest before the first frame.
    """
    p = parameters
    if p.structure.mocap_filter == "none":
        return frames_m
    from scipy.signal import butter, sosfilt, sosfilt_zi, sosfiltfilt  # slow to import

    sections = butter(2, p["sensor.mocap_cutoff_hz"], fs=p["sensor.mocap_rate_hz"], output="sos")
    if p.structure.mocap_filter == "zero_phase":
        return np.asarray(sosfiltfilt(sections, frames_m, axis=0))
    resting = sosfilt_zi(sections)[:, :, None, None] * frames_m[:1]
    return np.asarray(sosfilt(sections, frames_m, axis=0, zi=resting)[0])
