"""Servo of the rig: rotor, gear, friction and the control cascade of its firmware.

The rotor (with its inertia reflected to the output) drives the joint through a gear with backlash
and compliance; the encoder is on the rotor. The firmware has a position loop over a PI velocity
loop with a current limit. The friction level grows with the torque that the gear transmits,

    g(w) = F_c + mu |tau_gear| + F_s fade(w / w_s) + F_b exp(-s / d).

The distance s since the last reversal decays at rest, ds/dt = |w| - s / T. Set-point, position
loop, Stribeck's fade and the friction of this level have forms (`models.rig.forms`).
"""

from __future__ import annotations

import math
from collections import deque

from models.rig.forms import (
    CurrentRegister,
    friction_form,
    goal_form,
    play_in_gear_rad,
    position_gains,
    ripple_in_rate_rad,
    stribeck_form,
)
from models.rig.parameters import RigParameters


class RigServo:
    """A position servo, with the parameters of its joint (`RigParameters.of_joint`)."""

    def __init__(self, parameters: RigParameters, step_s: float) -> None:
        p = parameters
        self._step_s = step_s
        self._goal = goal_form(p, step_s)
        self._delay_s = p["servo.dead_time_s"]
        self._gains = position_gains(p)
        self._speed_limit = p["servo.speed_limit_rad_s"]
        self._inertia = p["servo.inertia_kg_m2"]
        constant = p["servo.torque_constant_nm_a"]
        # The firmware's gains assume the rated torque constant; the motor's may differ.
        self._velocity_gain = p["servo.velocity_bandwidth_rad_s"] * self._inertia / constant
        self._integral_gain = self._velocity_gain * p["servo.velocity_integral_rad_s"]
        self._torque_constant = constant * (1.0 - p["servo.torque_constant_loss"])
        self._limit_a = p["servo.current_limit_a"] - p["servo.current_limit_reduction_a"]
        self._coulomb = p["servo.coulomb_friction_nm"]
        self._load_friction = p["servo.load_friction_share"]
        self._stribeck, self._fade = p["servo.stribeck_friction_nm"], stribeck_form(p)
        self._breakaway = p["servo.breakaway_friction_nm"]
        self._breakaway_rad = p["servo.breakaway_distance_rad"]
        self._dwell_s = p["servo.breakaway_dwell_s"]
        self._friction = friction_form(p, step_s)
        self._cogging = p["servo.cogging_nm"]
        self._cogging_periods = p["servo.cogging_periods"], p["servo.cogging_phase_rad"]
        self._half_play = 0.5 * play_in_gear_rad(p)
        self._gear_stiffness = 1.0 / p["servo.gear_compliance_rad_nm"]
        self._gear_damping = p["servo.gear_damping_nm_s_rad"]
        self._encoder_offset = p["sensor.encoder_offset_rad"]
        self._ripple, self._rate_ripple = p["sensor.encoder_ripple_rad"], ripple_in_rate_rad(p)
        self._ripple_periods = (
            p["sensor.encoder_ripple_periods"], p["sensor.encoder_ripple_phase_rad"],
        )  # fmt: skip
        lag_s = p["sensor.current_lag_s"]
        self._lag = math.exp(-step_s / lag_s) if lag_s > 0.0 else 0.0
        self._register = CurrentRegister(p, step_s)
        self._pending: deque[tuple[float, float]] = deque()
        self._integral_a = self._slid_rad = self._sensed_a = self._lag_rad_s = 0.0
        self._forward = True
        self.load_nm = p["servo.load_offset_nm"]
        self.rotor_rad = self.rotor_rad_s = self.current_a = self.gear_nm = 0.0

    @property
    def encoder_rad(self) -> float:
        """Angle that encoder and firmware read, before quantisation."""
        read = self.rotor_rad + self._encoder_offset
        if self._ripple:
            periods, phase = self._ripple_periods
            read += self._ripple * math.sin(periods * self.rotor_rad + phase)
        return read

    @property
    def _measured_rad_s(self) -> float:
        """Rate that the velocity loop measures."""
        if not self._rate_ripple:
            return self.rotor_rad_s
        periods, phase = self._ripple_periods
        slope = self._rate_ripple * periods * math.cos(periods * self.rotor_rad + phase)
        return self.rotor_rad_s * (1.0 + slope)

    @property
    def sampled_current_a(self) -> float:
        """Motor current as the servo samples it for its register, before sensor errors."""
        return self._register.value_a

    def send(self, goal_rad: float, time_s: float) -> None:
        """Send a goal; it takes effect at the integration step nearest to the end of the delay."""
        self._pending.append((time_s + self._delay_s - 0.5 * self._step_s, goal_rad))

    def step(self, time_s: float, joint_rad: float, joint_rad_s: float) -> float:
        """Advance rotor and firmware; return the gear's torque on the joint, without `load_nm`."""
        while self._pending and self._pending[0][0] <= time_s + 1e-9:
            self._goal.take(self._pending.popleft()[1])
        self._update_current()
        self.gear_nm = self._gear(self.rotor_rad - joint_rad, self.rotor_rad_s - joint_rad_s)
        drive = self._torque_constant * self.current_a - self.gear_nm
        cogging = 0.0
        if self._cogging:
            periods, phase = self._cogging_periods
            cogging = self._cogging * math.sin(periods * self.rotor_rad + phase)
        level = self._friction_level()
        friction = self._friction.torque_nm(self.rotor_rad_s, level, drive - cogging)
        torque = self._torque_constant * self.current_a - friction - self.gear_nm - cogging
        self.rotor_rad_s += self._step_s * torque / self._inertia
        self.rotor_rad += self._step_s * self.rotor_rad_s
        return self.gear_nm

    def _update_current(self) -> None:
        lag = self._goal.advance() - self.encoder_rad
        self._lag_rad_s += self._step_s * lag
        gains = self._gains
        speed = gains.proportional * lag
        speed += gains.integral * self._lag_rad_s
        speed += gains.forward * self._goal.rate_rad_s
        speed = min(max(speed, -self._speed_limit), self._speed_limit)
        error = speed - self._measured_rad_s
        wanted = self._velocity_gain * error + self._integral_a
        self.current_a = min(max(wanted, -self._limit_a), self._limit_a)
        if self.current_a == wanted:  # anti-windup
            self._integral_a += self._step_s * self._integral_gain * error
        self._sensed_a = self.current_a + self._lag * (self._sensed_a - self.current_a)
        self._register.hold(self._sensed_a)

    def _gear(self, twist: float, rate: float) -> float:
        beyond = twist - min(max(twist, -self._half_play), self._half_play)
        if beyond == 0.0:
            return 0.0
        torque = self._gear_stiffness * beyond + self._gear_damping * rate
        return torque if torque * beyond > 0.0 else 0.0  # teeth push only

    def _friction_level(self) -> float:
        rate = self.rotor_rad_s
        level = self._coulomb + self._load_friction * abs(self.gear_nm)
        if self._stribeck:
            level += self._stribeck * self._fade(rate)
        if self._breakaway:
            if rate and (rate > 0.0) != self._forward:
                self._forward, self._slid_rad = rate > 0.0, 0.0
            self._slid_rad += self._step_s * (abs(rate) - self._slid_rad / self._dwell_s)
            level += self._breakaway * math.exp(-self._slid_rad / self._breakaway_rad)
        return level
