"""Forms of the rig's equations: what each choice of `RigStructure` means.

They are in the order of the signal: the link's moment, the servo, the motion capture. The forms of
the link's moment, in CasADi expressions, are those of the hinged link.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from firmware_py.signals import PERIOD_S
from models.rig.parameters import RigParameters
from models.shared.kinematics import Array

# ---- the link's moment: limit, creep, hysteresis -------------------------------------------------


def limited_fraction(parameters: RigParameters, level: Any) -> Any:
    """Moment over that of a link without limit, at a level x of this over the limit moment: f(x)/x.

    Choice `limit`. "tanh": f = tanh(x). "wrinkling": the wall wrinkles above half of the limit,
    f = x, then 1 - 1/(4 x). Half of the collapse moment is a tube's (Comer and Levy, *AIAA Journal*
    1, 1963 [recalled]); that a box has it too (theory: 2/3; docs/sources.md, "The link") and the
    shape are [assumed].
    """
    if parameters.structure.limit == "wrinkling":
        level = ca.fmax(level, 0.5)
        return (1.0 - 0.25 / level) / level
    level = level + 1e-12
    return ca.tanh(level) / level


class RelaxationSpectrum(NamedTuple):
    """Maxwell branches: times in s and fractions of the stiffness, shape (n,) each."""

    times_s: Array
    fractions: Array


def relaxation_spectrum(parameters: RigParameters) -> RelaxationSpectrum:
    """Maxwell branches whose fractions sum up to the relaxing one.

    Choice `creep`. "branches": three equal ones. "power_law": one per half decade, with the
    spectrum of a fractional element, which falls as tau^-alpha per decade (Mainardi, *Fractional
    Calculus and Waves in Linear Viscoelasticity*, 2010 [recalled]).
    """
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


def size_of(planes: Any) -> Any:
    """Length of the vector of each section, shape (1, n)."""
    return ca.sqrt(planes[0, :] ** 2 + planes[1, :] ** 2)


class HysteresisForm(NamedTuple):
    """Friction of n sections in two planes."""

    springs: int  # Number of state arrays, each of shape (2, n); zero when relaxed
    # State and further bend du (2, n) in rad -> state afterwards and moment (2, n) in N·m
    advance: Callable[[Sequence[Any], Any], tuple[list[Any], Any]]


def hysteresis_form(
    parameters: RigParameters, yield_rad: Array, stiffness_nm_rad: Array
) -> HysteresisForm:
    """Friction of the link's skin; `yield_rad` u_y and `stiffness_nm_rad` K have the shape (n,).

    Sliding, a section has the moment kappa K u_y. A small bend du from rest gives kappa K du in
    every form, so that a strength is the same fraction of the stiffness. Each form stores energy in
    a spring and dissipates it in a slider. Choice `hysteresis`:

    * "bouc_wen": dz = du/u_y - (|z.du| + z.du) z / (2 u_y) (Park, Wen and Ang, 1986 [recalled]);
    * "dahl": dz = du/u_y - |du| z / u_y (Dahl, 1968; exponent 1, in two planes);
    * "maxwell_slip": springs of equal stiffness with sliders of different yields in parallel (Iwan,
      *J. Applied Mechanics* 33, 1966 [recalled]); a spring beyond its yield is returned radially.

    The moment of the first two is kappa K u_y z; z is integrated implicitly.
    """
    p = parameters
    friction_nm = p["memory.hysteresis_share"] * stiffness_nm_rad * yield_rad

    def bristle(memory: Sequence[Any], du: Any) -> tuple[list[Any], Any]:
        (z,) = memory
        if p.structure.hysteresis == "dahl":
            shed = 1.0 + size_of(du) * ca.DM(1.0 / yield_rad).T
        else:
            along = z[0, :] * du[0, :] + z[1, :] * du[1, :]
            shed = 1.0 + (ca.fabs(along) + along) * ca.DM(0.5 / yield_rad).T
        z = (z + both_planes(1.0 / yield_rad) * du) / both_planes(shed)
        return [z], both_planes(friction_nm) * z

    if p.structure.hysteresis != "maxwell_slip":
        return HysteresisForm(1, bristle)
    yields = np.geomspace(1.0, p["memory.slip_range"], round(p["memory.slip_elements"]))
    slips_rad = (yields / yields.mean())[:, None] * yield_rad
    spring_nm_rad = friction_nm / yield_rad / len(yields)

    def sliders(memory: Sequence[Any], du: Any) -> tuple[list[Any], Any]:
        after = []
        for stretch, slip_rad in zip(memory, slips_rad, strict=True):
            stretched, slip = stretch + du, ca.DM(slip_rad).T
            after.append(stretched * both_planes(slip / ca.fmax(size_of(stretched), slip)))
        return after, both_planes(spring_nm_rad) * sum(after)

    return HysteresisForm(len(yields), sliders)


# ---- the servo: set-point, position loop, rate, friction, register -------------------------------


class SteppedGoal:
    """Choice `goal`: "held", the set-point jumps to each goal; "interpolated", it moves on a line.

    The line ends one control period after the goal; so long has a held goal the line's rate.
    """

    def __init__(self, step_s: float, interpolated: bool) -> None:
        self._steps = max(round(PERIOD_S / step_s), 1)
        self._step_s, self._interpolated, self._left = step_s, interpolated, 0
        self._goal_rad = self._setpoint_rad = self._per_step_rad = self.rate_rad_s = 0.0

    def take(self, goal_rad: float) -> None:
        self._per_step_rad = (goal_rad - self._setpoint_rad) / self._steps
        self._goal_rad, self._left = goal_rad, self._steps

    def advance(self) -> float:
        self.rate_rad_s = 0.0
        if self._left:
            self._left -= 1
            self.rate_rad_s = self._per_step_rad / self._step_s
            to_go = self._left * self._per_step_rad if self._interpolated else 0.0
            self._setpoint_rad = self._goal_rad - to_go
        return self._setpoint_rad


class ProfiledGoal:
    """Choice `goal` = "profile": the set-point moves with limited velocity and acceleration.

    It plans again from the current set-point when the next goal arrives (trapezoidal profile,
    e-Manual of ROBOTIS, "Profile Velocity").
    """

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


def goal_form(parameters: RigParameters, step_s: float) -> SteppedGoal | ProfiledGoal:
    """Set-point of a servo, at rest at zero.

    `take` a goal that takes effect now; `advance` by a step and return the set-point in rad;
    `rate_rad_s` is its rate in that step.
    """
    p = parameters
    if p.structure.goal != "profile":
        return SteppedGoal(step_s, p.structure.goal == "interpolated")
    return ProfiledGoal(
        step_s, p["servo.profile_velocity_rad_s"], p["servo.profile_acceleration_rad_s2"]
    )


class PositionGains(NamedTuple):
    """Position loop: the rate k_p e + k_i S + k_f dr/dt, with e = r - q and dS/dt = e."""

    proportional: float
    integral: float
    forward: float


def position_gains(parameters: RigParameters) -> PositionGains:
    """Choice `position_loop`: "proportional" has k_p alone, "feedforward" all three."""
    p = parameters
    proportional = p["servo.position_gain_per_s"] * (1.0 + p["servo.position_gain_change"])
    if p.structure.position_loop == "proportional":
        return PositionGains(proportional, 0.0, 0.0)
    integral, forward = p["servo.position_integral_per_s2"], p["servo.velocity_feedforward"]
    return PositionGains(proportional, integral, forward)


def ripple_in_rate_rad(parameters: RigParameters) -> float:
    """Periodic error of the encoder as it enters the rate of the velocity loop.

    Choice `rate_sensor`: "motor" has none of it, "encoder" all.
    """
    measured = parameters.structure.rate_sensor == "encoder"
    return parameters["sensor.encoder_ripple_rad"] if measured else 0.0


def stribeck_form(parameters: RigParameters) -> Callable[[float], float]:
    """Fraction of Stribeck friction at a rate w.

    Choice `stribeck`: "gaussian", exp(-(w/w_s)^2), or "rational", 1 / (1 + (w/w_s)^2).
    """
    speed = parameters["servo.stribeck_speed_rad_s"]
    if parameters.structure.stribeck == "rational":
        return lambda rate: 1.0 / (1.0 + (rate / speed) ** 2)
    return lambda rate: math.exp(-((rate / speed) ** 2))


class LugreFriction:
    """Choice `friction` = "lugre" (Canudas de Wit et al., 1995 [recalled]).

    dz/dt = w - sigma_0 |w| z / g, F = sigma_0 z + sigma_1 dz/dt + B w, with z implicit, so that
    |sigma_0 z| never exceeds the level g (`models.rig.servo`).
    """

    def __init__(self, parameters: RigParameters, step_s: float) -> None:
        self._step_s = step_s
        self._viscous = parameters["servo.viscous_friction_nm_s_rad"]
        self._bristle = parameters["servo.bristle_stiffness_nm_rad"]
        self._bristle_damping = parameters["servo.bristle_damping_nm_s_rad"]
        self._bristle_rad = 0.0

    def torque_nm(self, rate_rad_s: float, level_nm: float, drive_nm: float) -> float:
        """Advance by one step; return the torque against the motion in N·m."""
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
    """Choice `friction` = "smooth": F = g w / sqrt(w^2 + w_0^2) + B w (shape [assumed]).

    It has no presliding, and a load below g moves it slowly. The factor of w is that at the start
    of the step and w that at its end, so friction never drives the rotor.
    """

    def __init__(self, parameters: RigParameters, step_s: float) -> None:
        self._step_per_inertia = step_s / parameters["servo.inertia_kg_m2"]
        self._viscous = parameters["servo.viscous_friction_nm_s_rad"]
        self._rate_0 = parameters["servo.smooth_rate_rad_s"]

    def torque_nm(self, rate_rad_s: float, level_nm: float, drive_nm: float) -> float:
        """Torque against the motion in N·m, with the torque that drives the rotor otherwise."""
        factor = level_nm / math.hypot(rate_rad_s, self._rate_0) + self._viscous
        free = rate_rad_s + self._step_per_inertia * drive_nm
        return factor * free / (1.0 + self._step_per_inertia * factor)


def friction_form(parameters: RigParameters, step_s: float) -> LugreFriction | SmoothFriction:
    form = LugreFriction if parameters.structure.friction == "lugre" else SmoothFriction
    return form(parameters, step_s)


class CurrentRegister:
    """Current that the servo's register holds when the robot reads it.

    Choice `current_sampling`: at the "tick"; at a "phase" of the period before; or as "mean" over
    that period. Servos read and filter their current in a cycle of their own.
    """

    def __init__(self, parameters: RigParameters, step_s: float) -> None:
        sampling = parameters.structure.current_sampling
        steps = PERIOD_S / step_s
        late = {"tick": 0.0, "phase": parameters["sensor.current_phase"] * steps, "mean": steps - 1}
        self._mean = sampling == "mean"
        self._window: deque[float] = deque([0.0], maxlen=round(late[sampling]) + 1)
        self.hold = self._window.append
        """Call it with the current in A after each step."""

    @property
    def value_a(self) -> float:
        if self._mean:
            return sum(self._window) / len(self._window)
        return self._window[0]


# ---- play, and the motion capture ----------------------------------------------------------------


def play_in_gear_rad(parameters: RigParameters) -> float:
    """Play of the gear. Choice `play`: all of it is in the "gear", or in the "markers"."""
    return parameters["servo.backlash_rad"] if parameters.structure.play == "gear" else 0.0


class MarkerPlay:
    """Choice `play` = "markers": play in the link's mount, which moves only the markers.

    The link leans by half of the play to the side that its torque pushes to. It moves from one side
    to the other within a small range of torque and a short time, at first from the middle.
    """

    def __init__(self, parameters: RigParameters, dof: int, step_s: float) -> None:
        p = parameters
        joints = [p.of_joint(k + 1) for k in range(dof)]
        self._half_rad = [0.5 * (q["servo.backlash_rad"] - play_in_gear_rad(q)) for q in joints]
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
    """Frames (n, markers, 3) of a link at rest before the first, after the software's filter.

    Choice `mocap_filter`: "none", or a Butterworth filter of second order (*Wireless Engineer* 7,
    1930 [recalled]). "low_pass": forward, as in a live stream. "zero_phase": forward and backward,
    as software filters a recording, with a response of one half at the cut-off (Winter,
    *Biomechanics and Motor Control of Human Movement* [recalled]).
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
