"""Configuration of a robot: `robot.toml`, of which every key is checked."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.bus import bus_plan
from firmware_py.bus.dynamixel import watchdog_steps
from firmware_py.bus.registers import RETURN_DELAY_STEP_S, Register
from firmware_py.bus.servo_models import ServoGains, check_models, model_named
from firmware_py.bus.servo_setup import AssumedSettings, ServoSetup, check_assumed, check_ids
from firmware_py.bus.transport import BAUD_RATES
from firmware_py.core.errors import InputError
from firmware_py.core.input_files import convert, read_toml
from firmware_py.core.motion import GLIDE_S, MotionConfig
from firmware_py.core.signals import PERIOD_S, unit_of
from firmware_py.core.units import symbol_of
from firmware_py.inference.bundle_signature import TrustConfig, key_bytes
from firmware_py.inference.compiled_observer import Runtime
from firmware_py.log.sinks import LiveConfig
from firmware_py.safety.estimate_trust import TrustOptions
from firmware_py.safety.limits import Limits, limits_with_link
from firmware_py.safety.supervisor import check_motion
from firmware_py.system.clock import RealTimeOptions

Array = NDArray[np.float64]
SCHEMA: Final = 1
UNWATCHED_RATE_RAD_S: Final = 1.0
"""Rate limit for servos without a bus watchdog; the study's motion needs 0.76 rad/s."""
_MAX_DOF: Final = 2


class BusConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Table `[bus]`: port and timing of the servos' bus."""

    # Serial device, or `unix:PATH` of an emulator's socket; with wildcards, the first that opens
    port: str
    baud: int = 1_000_000
    reply_timeout_s: float = 0.008  # Longest wait for the servos in a tick, retry included
    return_delay_s: float | None = None  # Return delay to write to the servos; None keeps theirs
    # Timeout for a disconnected port. When it is back, every start-up check is repeated and the
    # goals blend from the measured position into the motion. 0: the robot stays stopped.
    replug_s: float = 0.0


class ServoConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Entry of `[[servos]]`, one per joint in joint order."""

    id: int
    model: str  # Name of the model, one of `firmware_py.bus.servo_models.MODELS`
    reverse: bool = False  # Whether the servo counts in reverse (register Drive Mode)
    # Register Homing Offset: the servo adds this angle, so that zero is where the link is upright
    homing_offset_rad: float = 0.0
    # Gains with which the plant was identified; None skips the comparison
    gains: ServoGains | None = None

    def assumed(self) -> AssumedSettings:
        gains = self.gains.registers() if self.gains else {}
        return AssumedSettings(self.reverse, self.homing_offset_rad, gains)


class RobotConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Contents of `robot.toml`; the commented example is at the root of the repository."""

    schema: int = SCHEMA
    bundle: str  # Directory of the bundle, relative to the file
    bus: BusConfig
    servos: tuple[ServoConfig, ...]  # One per joint, in joint order
    # `link.toml`, relative to the file, see `firmware_py.link.link_description`; "" for none
    link: str = ""
    period_s: float = PERIOD_S
    # Mass at the tip; None if it is unknown and the observer estimates it
    payload_kg: float | None = None
    # What evaluates the predictor; None uses the compiled one if the bundle has it
    runtime: Runtime | None = None
    record: bool = True  # Whether the recorder process writes the ticks to a file
    logs: str = "logs"  # Directory of the logs, relative to the file
    motion: MotionConfig = MotionConfig()  # Tables of these names
    limits: Limits = Limits()
    feedback: TrustOptions = TrustOptions()
    live: LiveConfig = LiveConfig()
    trust: TrustConfig = TrustConfig()
    real_time: RealTimeOptions = RealTimeOptions()

    @property
    def dof(self) -> int:
        return len(self.servos)

    @property
    def limits_in_force(self) -> Limits:
        """The configured limits, with a lower rate where a servo has no bus watchdog."""
        models = [model_named(servo.model) for servo in self.servos]
        if all(Register.BUS_WATCHDOG in model.table for model in models):
            return self.limits
        rate = min(self.limits.rate_rad_s, UNWATCHED_RATE_RAD_S)
        return msgspec.structs.replace(self.limits, rate_rad_s=rate)

    def setups(self) -> tuple[ServoSetup, ...]:
        """Return the servos as `firmware_py.bus.dynamixel.DynamixelBus` takes them."""
        (low, high), rate = self.limits.angle_rad, self.limits_in_force.rate_rad_s
        return tuple(
            ServoSetup(s.id, model_named(s.model), low, high, rate, s.assumed())
            for s in self.servos
        )

    @property
    def transmission_budget_s(self) -> float:
        return bus_plan.available_s(self.period_s, self.bus.reply_timeout_s)

    def bus_plans(self) -> list[bus_plan.Plan]:
        """Return the plans to read the servos, fastest first; see `firmware_py.bus.bus_plan`."""
        delay_s = self.bus.return_delay_s
        return bus_plan.plans(
            self.setups()[0].model.table, self.dof, self.bus.baud,
            bus_plan.FACTORY_RETURN_DELAY_S if delay_s is None else delay_s,
        )  # fmt: skip

    def goals_rad(self, *, repeated: bool = False) -> Array:
        """Return the goals of the motion in rad, one row per period, shape (n, dof).

        The rest precedes the motion. A table that will be repeated also returns to zero at its end.
        """
        motion = self.motion.motion(self.dof)
        rest = round(self.motion.rest_s / self.period_s)
        goals = motion.table_rad(self.period_s, rest)
        if repeated:
            times_s = motion.duration_s + np.arange(round(GLIDE_S / self.period_s)) * self.period_s
            goals = np.concatenate([goals, motion.goal_rad(times_s)])
        check_motion(goals, self.limits_in_force, self.period_s, f"motion {motion.kind}")
        return goals


def read_config(path: Path | str) -> RobotConfig:
    path = Path(path)
    document = read_toml(path, "copy the commented robot.toml and adapt it")
    config = convert(document, RobotConfig, path, "", "see the commented robot.toml for every key")
    check_models([servo.model for servo in config.servos], path)
    if config.motion.file is not None:
        motion = config.motion.with_file(path.parent / config.motion.file)
        config = msgspec.structs.replace(config, motion=motion)
    if config.link:
        models, limits_table = [s.model for s in config.servos], document.get("limits", {})
        bounded = limits_with_link(path, config.link, models, config.limits, limits_table)
        config = msgspec.structs.replace(config, limits=bounded)
    check_config(config, path)
    return config


def check_config(config: RobotConfig, path: Path | str) -> None:
    """Refuse values that are out of range or do not fit together.

    `path`: source of the configuration, named in the message.
    """
    if config.schema != SCHEMA:
        raise InputError(path, f"schema is {config.schema}", f"this version reads {SCHEMA}")
    if config.dof == 0:
        raise InputError(path, "servos has no entry", "give one per joint, 1 or 2")
    _check_ranges(config, path)
    if config.bus.baud not in BAUD_RATES:
        offered = ", ".join(map(str, BAUD_RATES))
        raise InputError(path, f"bus.baud is {config.bus.baud}", f"choose from {offered}")
    bus_plan.require_any(config.bus_plans(), config.transmission_budget_s, path)
    if config.dof > _MAX_DOF:
        raise InputError(path, f"servos has {config.dof} entries", "give one per joint, 1 or 2")
    names = {"bundle": config.bundle, "logs": config.logs, "bus.port": config.bus.port}
    for key, name in names.items():
        if not name.isprintable():
            raise InputError(path, f"{key} is {name!r}", "give a name without control characters")
    try:
        config.motion.motion(config.dof)
    except InputError as error:
        raise InputError(path, f"motion.{error.where} {error.what}", error.remedy) from None
    check_ids([servo.id for servo in config.servos], path)
    for key in config.trust.keys:
        key_bytes(key, path)
    for setup in config.setups():
        check_assumed(setup, path)
        if Register.BUS_WATCHDOG in setup.model.table:
            watchdog_steps(config.period_s, path)


def _check_ranges(config: RobotConfig, path: Path | str) -> None:
    limits, bus = config.limits, config.bus
    ranges = (
        ("period_s", config.period_s, 1e-3, 1.0),
        ("payload_kg", config.payload_kg, 0.0, 100.0),
        ("bus.reply_timeout_s", bus.reply_timeout_s, 1e-4, config.period_s),
        ("bus.replug_s", bus.replug_s, 0.0, 3600.0),
        ("bus.return_delay_s", bus.return_delay_s, 0.0, 254 * RETURN_DELAY_STEP_S),
        ("motion.rest_s", config.motion.rest_s, 0.0, 60.0),
        ("limits.rate_rad_s", limits.rate_rad_s, 1e-3, 100.0),
        ("limits.acceleration_rad_s2", limits.acceleration_rad_s2, 1e-3, 1e4),
        ("limits.current_a", limits.current_a, 1e-3, 100.0),
        ("limits.following_error_rad", limits.following_error_rad, 1e-3, 3.2),
        ("limits.jump_rad", limits.jump_rad, 1e-3, 3.2),
        ("limits.persistence_ticks", limits.persistence_ticks, 1, 100),
        ("limits.frozen_ticks", limits.frozen_ticks, 1, 1000),
        ("limits.stale_ticks", limits.stale_ticks, 1, 100),
        ("limits.missed_slots", limits.missed_slots, 1, 1000),
        ("limits.blend_s", limits.blend_s, 0.0, 60.0),
        ("limits.stop_deceleration_rad_s2", limits.stop_deceleration_rad_s2, 1e-2, 1e4),
        ("limits.hold_s", limits.hold_s, 0.0, 3600.0),
        ("feedback.bad_ticks", config.feedback.bad_ticks, 1, 100),
        ("feedback.regain_s", config.feedback.regain_s, 0.0, 3600.0),
        ("live.port", config.live.port, 0, 65535),
        ("live.viewers", config.live.viewers, 1, 100),
        ("real_time.priority", config.real_time.priority, 0, 99),
        ("real_time.cpu", config.real_time.cpu, 0, 4095),
    )
    for key, value, low, high in ranges:
        if value is not None and not low <= value <= high:
            unit = f" {symbol_of(unit_of(key) or '1')}".rstrip()
            what = "a mass from " if unit == " kg" else ""
            raise InputError(
                path, f"{key} is {value:.10g}{unit}", f"give {what}{low:g} to {high:g}{unit}"
            )
    low, high = limits.angle_rad
    if not -math.pi <= low < high <= math.pi:
        raise InputError(path, f"limits.angle_rad is [{low}, {high}]", "give low < high, in rad")
    for k, axis in enumerate("xyz"):
        if not limits.tip_min_m[k] < limits.tip_max_m[k]:
            raise InputError(
                path, f"limits.tip_min_m and tip_max_m are empty along {axis}", "give min < max"
            )
