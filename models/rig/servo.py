"""Servo of the rig: rotor, gear, friction and the control cascade of its firmware.

The rotor (with its inertia reflected to the output) drives the joint through a gear with backlash
and compliance; the encoder is on the rotor. The friction level grows with the torque that the gear
transmits:

    g(w) = F_c + mu |tau_gear| + F_s exp(-(w / w_s)^2) + F_b exp(-s / d).

The distance s since the last reversal decays at rest, ds/dt = |w| - s / T. The forms of friction
and set-point are those of `models.rig.forms`. The position loop sets the rate

    k_p e + k_i S + k_f dr/dt,   e = r - q,   dS/dt = e,

if the structure's position loop has feed-forward, else k_p e alone.
"""

from __future__ import annotations

import math
from collections import deque

from models.rig.forms import CurrentRegister, friction_form, goal_form
from models.rig.parameters import RigParameters


class RigServo:
    """A position servo: position loop, PI velocity loop, current limit.

    The parameters include what is added in this joint alone (`RigParameters.of_joint`).
    """

    def __init__(self, parameters: RigParameters, step_s: float) -> None:
        p = parameters
        self._step_s = step_s
        gain_change = p["servo.position_gain_change"]
        self._position_gain = p["servo.position_gain_per_s"] * (1.0 + gain_change)
        extended = p.structure.position_loop == "feedforward"
        self._feedforward = p["servo.velocity_feedforward"] if extended else 0.0
        self._position_integral = p["servo.position_integral_per_s2"] if extended else 0.0
        self._speed_limit = p["servo.speed_limit_rad_s"]
        self._inertia = p["servo.inertia_kg_m2"]
        constant = p["servo.torque_constant_nm_a"]
        # The firmware's gains assume the rated torque constant; the motor's may differ.
        self._velocity_gain = p["servo.velocity_bandwidth_rad_s"] * self._inertia / constant
        self._integral_gain = self._velocity_gain * p["servo.velocity_integral_rad_s"]
        self._torque_constant = constant * (1.0 - p["servo.torque_constant_loss"])
        self._limit_a = p["servo.current_limit_a"] - p["servo.current_limit_reduction_a"]
        self._coulomb = p["servo.coulomb_friction_nm"]
        self._stribeck = p["servo.stribeck_friction_nm"]
        self._stribeck_speed = p["servo.stribeck_speed_rad_s"]
        self._fades_rationally = p.structure.stribeck == "rational"
        self._breakaway = p["servo.breakaway_friction_nm"]
        self._breakaway_rad = p["servo.breakaway_distance_rad"]
        self._dwell_s = p["servo.breakaway_dwell_s"]
        self._cogging = p["servo.cogging_nm"]
        self._cogging_periods = p["servo.cogging_periods"], p["servo.cogging_phase_rad"]
        self._load_friction = p["servo.load_friction_share"]
        self._friction = friction_form(p, step_s)
        in_gear = p.structure.play == "gear"
        self._half_play = 0.5 * p["servo.backlash_rad"] if in_gear else 0.0
        self._gear_stiffness = 1.0 / p["servo.gear_compliance_rad_nm"]
        self._gear_damping = p["servo.gear_damping_nm_s_rad"]
        self._delay_s = p["servo.dead_time_s"]
        self._encoder_offset = p["sensor.encoder_offset_rad"]
        self._ripple = p["sensor.encoder_ripple_rad"]
        self._ripple_in_rate = p.structure.rate_sensor == "encoder"
        self._ripple_periods = (
            p["sensor.encoder_ripple_periods"], p["sensor.encoder_ripple_phase_rad"],
        )  # fmt: skip
        lag_s = p["sensor.current_lag_s"]
        self._lag = math.exp(-step_s / lag_s) if lag_s > 0.0 else 0.0
        self._pending: deque[tuple[float, float]] = deque()
        self._goal = goal_form(p, step_s)
        self._register = CurrentRegister(p, step_s)
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
        if not (self._ripple and self._ripple_in_rate):
            return self.rotor_rad_s
        periods, phase = self._ripple_periods
        slope = self._ripple * periods * math.cos(periods * self.rotor_rad + phase)
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
        speed = self._position_gain * lag
        speed += self._position_integral * self._lag_rad_s
        speed += self._feedforward * self._goal.rate_rad_s
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
        level = self._coulomb + self._load_friction * abs(self.gear_nm)
        if self._stribeck:
            level += self._stribeck * self._near_standstill(self.rotor_rad_s)
        if self._breakaway:
            level += self._breakaway_level(self.rotor_rad_s)
        return level

    def _near_standstill(self, rate: float) -> float:
        """Remaining fraction of Stribeck friction at a rate (`models.plant.effects.friction`)."""
        squared = (rate / self._stribeck_speed) ** 2
        return 1.0 / (1.0 + squared) if self._fades_rationally else math.exp(-squared)

    def _breakaway_level(self, rate: float) -> float:
        """Friction above the sliding level: full after a reversal, fading with the distance."""
        if rate and (rate > 0.0) != self._forward:
            self._forward, self._slid_rad = rate > 0.0, 0.0
        self._slid_rad += self._step_s * (abs(rate) - self._slid_rad / self._dwell_s)
        return self._breakaway * math.exp(-self._slid_rad / self._breakaway_rad)
