"""Servo of the rig: rotor, gear, friction and the control cascade of its firmware.

The rotor (with its inertia reflected to the output) drives the joint through a gear with backlash
and compliance; the encoder is on the rotor. The firmware has a position loop over a PI velocity
loop with a current limit. With the error e = r - q of the set-point and dS/dt = e, the position
loop sets the rate

    k_p e                       (choice `position_loop` = "proportional"), or
    k_p e + k_i S + k_f dr/dt   ("feedforward").

The friction level grows with the torque that the gear transmits,

    g(w) = F_c + mu |tau_gear| + F_s fade(w / w_s) + F_b exp(-s / d),

with the fade exp(-x^2) (choice `stribeck` = "gaussian") or 1 / (1 + x^2) ("rational"). The distance
s since the last reversal decays at rest, ds/dt = |w| - s / T. The velocity loop measures the rate
at the "motor" (choice `rate_sensor`) or at the "encoder", with the encoder's periodic error.
"""

from __future__ import annotations

import math
from collections import deque
from types import SimpleNamespace

from firmware_py.core.signals import PERIOD_S
from models.rig.parameters import RigParameters


class SteppedGoal:
    """Choice `goal`: "held", the set-point jumps to each goal; "interpolated", it moves on a line.

    The line ends one control period after the goal. For that time both have the rate of the line.
    """

    def __init__(self, step_s: float, interpolated: bool) -> None:
        self._steps = max(round(PERIOD_S / step_s), 1)
        self._step_s, self._interpolated, self._remaining = step_s, interpolated, 0
        self._goal_rad = self._setpoint_rad = self._per_step_rad = self.rate_rad_s = 0.0

    def take(self, goal_rad: float) -> None:
        self._per_step_rad = (goal_rad - self._setpoint_rad) / self._steps
        self._goal_rad, self._remaining = goal_rad, self._steps

    def advance(self) -> float:
        self.rate_rad_s = 0.0
        if self._remaining:
            self._remaining -= 1
            self.rate_rad_s = self._per_step_rad / self._step_s
            to_go = self._remaining * self._per_step_rad if self._interpolated else 0.0
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
        to_go = self._goal_rad - self._setpoint_rad
        # With n steps of braking from the velocity n a h, the distance is a h^2 n (n + 1) / 2.
        steps = math.sqrt(0.25 + 2.0 * abs(to_go) / (self._gain * self._step_s)) - 0.5
        speed = min(self._gain * steps, abs(to_go) / self._step_s, self._fastest)
        wanted = math.copysign(speed, to_go)
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


class LugreFriction:
    """Choice `friction` = "lugre" (Canudas de Wit et al., 1995 [recalled]).

    dz/dt = w - sigma_0 |w| z / g, F = sigma_0 z + sigma_1 dz/dt + B w, with z implicit, so that
    |sigma_0 z| never exceeds the level g.
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


def current_register(parameters: RigParameters, step_s: float) -> deque[float]:
    """Window of the current whose oldest value, or mean, the servo's register holds.

    Choice `current_sampling`: at the "tick"; at a "phase" of the period before; or as "mean" over
    that period. Servos read and filter their current in a cycle that is not the robot's.
    """
    steps = PERIOD_S / step_s
    late = {"tick": 0.0, "phase": parameters["sensor.current_phase"] * steps, "mean": steps - 1}
    return deque([0.0], maxlen=round(late[parameters.structure.current_sampling]) + 1)


class RigServo:
    """A position servo, with the parameters of its joint (`RigParameters.of_joint`)."""

    def __init__(self, parameters: RigParameters, step_s: float) -> None:
        p, structure = parameters, parameters.structure
        self._step_s = step_s
        # Attributes are read in every step, ten times as fast as the mapping.
        self._servo = servo = SimpleNamespace(
            **{n.removeprefix("servo."): v for n, v in p.items() if n.startswith("servo.")}
        )
        self._goal = goal_form(p, step_s)
        friction = LugreFriction if structure.friction == "lugre" else SmoothFriction
        self._friction = friction(p, step_s)
        self._register = current_register(p, step_s)
        self._mean_current = structure.current_sampling == "mean"
        self._rational = structure.stribeck == "rational"
        self._position_gain = servo.position_gain_per_s * (1.0 + servo.position_gain_change)
        feedforward = structure.position_loop == "feedforward"
        self._position_integral = servo.position_integral_per_s2 if feedforward else 0.0
        self._forward_gain = servo.velocity_feedforward if feedforward else 0.0
        # The firmware's gains assume the rated torque constant; the motor's may differ.
        rated_nm_a = servo.torque_constant_nm_a
        self._velocity_gain = servo.velocity_bandwidth_rad_s * servo.inertia_kg_m2 / rated_nm_a
        self._integral_gain = self._velocity_gain * servo.velocity_integral_rad_s
        self._torque_constant = rated_nm_a * (1.0 - servo.torque_constant_loss)
        self._limit_a = servo.current_limit_a - servo.current_limit_reduction_a
        self._half_play = 0.5 * servo.backlash_rad if structure.play == "gear" else 0.0
        self._gear_stiffness = 1.0 / servo.gear_compliance_rad_nm
        self._encoder_offset = p["sensor.encoder_offset_rad"]
        self._ripple = p["sensor.encoder_ripple_rad"]
        self._rate_ripple = self._ripple if structure.rate_sensor == "encoder" else 0.0
        self._ripple_periods = p["sensor.encoder_ripple_periods"]
        self._ripple_phase = p["sensor.encoder_ripple_phase_rad"]
        lag_s = p["sensor.current_lag_s"]
        self._lag = math.exp(-step_s / lag_s) if lag_s > 0.0 else 0.0
        self._pending: deque[tuple[float, float]] = deque()
        self._integral_a = self._slid_rad = self._sensed_a = self._lag_rad_s = 0.0
        self._forward = True
        self.load_nm = servo.load_offset_nm
        self.rotor_rad = self.rotor_rad_s = self.current_a = self.gear_nm = 0.0

    @property
    def encoder_rad(self) -> float:
        """Angle that encoder and firmware read, before quantisation."""
        ripple = self._ripple * math.sin(self._ripple_periods * self.rotor_rad + self._ripple_phase)
        return self.rotor_rad + self._encoder_offset + ripple

    @property
    def sampled_current_a(self) -> float:
        """Motor current as the servo samples it for its register, before sensor errors."""
        register = self._register
        return sum(register) / len(register) if self._mean_current else register[0]

    def send(self, goal_rad: float, time_s: float) -> None:
        """Send a goal; it takes effect at the integration step nearest to the end of the delay."""
        due_s = time_s + self._servo.dead_time_s - 0.5 * self._step_s
        self._pending.append((due_s, goal_rad))

    def step(self, time_s: float, joint_rad: float, joint_rad_s: float) -> float:
        """Advance rotor and firmware; return the gear's torque on the joint, without `load_nm`."""
        while self._pending and self._pending[0][0] <= time_s + 1e-9:
            self._goal.take(self._pending.popleft()[1])
        self._update_current()
        servo = self._servo
        self.gear_nm = self._gear(self.rotor_rad - joint_rad, self.rotor_rad_s - joint_rad_s)
        phase = servo.cogging_periods * self.rotor_rad + servo.cogging_phase_rad
        cogging = servo.cogging_nm * math.sin(phase)
        motor = self._torque_constant * self.current_a
        level = self._friction_level()
        friction = self._friction.torque_nm(self.rotor_rad_s, level, motor - self.gear_nm - cogging)
        torque = motor - friction - self.gear_nm - cogging
        self.rotor_rad_s += self._step_s * torque / servo.inertia_kg_m2
        self.rotor_rad += self._step_s * self.rotor_rad_s
        return self.gear_nm

    def _update_current(self) -> None:
        lag = self._goal.advance() - self.encoder_rad
        self._lag_rad_s += self._step_s * lag
        speed = self._position_gain * lag
        speed += self._position_integral * self._lag_rad_s
        speed += self._forward_gain * self._goal.rate_rad_s
        limit = self._servo.speed_limit_rad_s
        error = min(max(speed, -limit), limit) - self._measured_rad_s()
        wanted = self._velocity_gain * error + self._integral_a
        self.current_a = min(max(wanted, -self._limit_a), self._limit_a)
        if self.current_a == wanted:  # anti-windup
            self._integral_a += self._step_s * self._integral_gain * error
        self._sensed_a = self.current_a + self._lag * (self._sensed_a - self.current_a)
        self._register.append(self._sensed_a)

    def _measured_rad_s(self) -> float:
        if not self._rate_ripple:
            return self.rotor_rad_s
        phase = self._ripple_periods * self.rotor_rad + self._ripple_phase
        slope = self._rate_ripple * self._ripple_periods * math.cos(phase)
        return self.rotor_rad_s * (1.0 + slope)

    def _gear(self, twist: float, rate: float) -> float:
        beyond = twist - min(max(twist, -self._half_play), self._half_play)
        if beyond == 0.0:
            return 0.0
        torque = self._gear_stiffness * beyond + self._servo.gear_damping_nm_s_rad * rate
        return torque if torque * beyond > 0.0 else 0.0  # teeth push only

    def _friction_level(self) -> float:
        servo, rate = self._servo, self.rotor_rad_s
        level = servo.coulomb_friction_nm + servo.load_friction_share * abs(self.gear_nm)
        if servo.stribeck_friction_nm:
            square = (rate / servo.stribeck_speed_rad_s) ** 2
            fade = 1.0 / (1.0 + square) if self._rational else math.exp(-square)
            level += servo.stribeck_friction_nm * fade
        if servo.breakaway_friction_nm:
            if rate and (rate > 0.0) != self._forward:
                self._forward, self._slid_rad = rate > 0.0, 0.0
            decay = self._slid_rad / servo.breakaway_dwell_s
            self._slid_rad += self._step_s * (abs(rate) - decay)
            fade = math.exp(-self._slid_rad / servo.breakaway_distance_rad)
            level += servo.breakaway_friction_nm * fade
        return float(level)
