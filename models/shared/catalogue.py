"""Catalogue of physical effects: names, ports and the SI unit of their strength.

The rig (`models.rig`) and the plant (`models.plant.effects`) model each effect by different
equations. They share this table, which is a contract: `--hide NAME=STRENGTH` adds STRENGTH, in this
unit, to the rig's default. A strength of zero means that the effect is absent. An effect of the
servo, a joint or a sensor is the same in every driven joint, unless `--hide NAME:JOINT=STRENGTH`
adds it in a single joint.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, Literal, NamedTuple

from firmware_py.core.errors import InputError

Port = Literal[
    "command", "servo_torque", "joint_torque", "bend_torque", "stiffness", "mass", "sensor"
]


REFERENCE_BEND_RAD: Final = 0.1
"""Bend (of the root, or of the whole span) at which softening and hardening are defined."""

LEAK_TIME_S: Final = 10.0
"""Time in which the leaking fraction is lost."""


class Row(NamedTuple):
    """Row of the catalogue."""

    port: Port  # Place where the effect acts
    unit: str  # Unit of the strength (the first parameter); "1" for a fraction
    strength: str  # Meaning of the strength
    size: float = math.nan  # Strength that would be noticed on the bench; NaN for none


CATALOGUE: Final[dict[str, Row]] = {
    "coulomb_friction": Row("servo_torque", "N.m", "dry friction torque at the output", 2),
    "viscous_friction": Row("servo_torque", "N.m.s/rad", "friction torque per joint rate", 3),
    "stribeck_friction": Row("servo_torque", "N.m", "extra friction near standstill", 3),
    "stiction": Row("servo_torque", "N.m", "breakaway torque above sliding friction", 3),
    "load_dependent_friction": Row("servo_torque", "1", "friction per transmitted torque", 0.08),
    "cogging": Row("servo_torque", "N.m", "amplitude of the torque periodic in the angle", 2),
    "backlash": Row("servo_torque", "rad", "full backlash of the gear", 0.006),
    "joint_elasticity": Row("servo_torque", "rad/(N.m)", "gear wind-up per torque", 0.0005),
    "dead_time": Row("command", "s", "delay of the goal on its way to the servo's loop", 0.03),
    "position_gain_change": Row("command", "1", "relative change of the position loop's gain", 0.2),
    "current_saturation": Row("command", "A", "reduction of the current limit", 7),
    "torque_constant_drift": Row("servo_torque", "1", "relative loss of torque per ampere", 0.1),
    "unmodelled_payload": Row("mass", "kg", "mass at the tip beyond the declared payload", 0.3),
    "payload_offset": Row("mass", "1", "payload's offset towards +x per link length", 0.03),
    "prebend": Row("bend_torque", "rad", "bend of the unloaded link towards +x", 0.03),
    "directional_stiffness": Row("stiffness", "1", "stiffer for positive bend, softer else", 0.15),
    "stiffness_softening": Row("stiffness", "1", "stiffness lost at 0.1 rad of bend", 0.15),
    "stiffness_hardening": Row("stiffness", "1", "stiffness gained at 0.1 rad of bend", 0.3),
    "pressure_leak": Row("stiffness", "1", "fraction of stiffness lost per 10 s", 0.1),
    "hysteresis": Row("bend_torque", "1", "Bouc-Wen fraction of the bending stiffness", 0.3),
    "creep": Row("bend_torque", "1", "relaxing fraction of the stiffness", 0.3),
    "aerodynamic_drag": Row("joint_torque", "N.m", "drag torque at 1 rad/s, quadratic", 2),
    "cross_axis_coupling": Row("bend_torque", "1", "torque of one plane per other plane's", 0.2),
    "encoder_offset": Row(
        "sensor", "rad", "constant error of the measured angle, which the servo controls", 0.02
    ),
    "encoder_ripple": Row("sensor", "rad", "amplitude of the encoder's periodic error", 0.004),
    "load_offset": Row("joint_torque", "N.m", "constant torque on the joint", 3),
    "current_bias": Row("sensor", "A", "constant error of the measured current", 0.2),
    "current_scale": Row("sensor", "1", "relative error of the measured current", 0.1),
    "marker_frame_tilt": Row("sensor", "rad", "tilt of the mocap frame about y", 0.015),
    "marker_scale": Row("sensor", "1", "relative error of the mocap's scale", 0.01),
    "sync_offset": Row("sensor", "s", "delay of the mocap behind the servo", 0.03),
    "sensor_lag": Row("sensor", "s", "low-pass time of the measured current", 0.02),
}  # fmt: skip

BEYOND_THE_RIG: Final[dict[str, Row]] = {
    "directional_friction": Row(
        "servo_torque", "N.m.s/rad", "viscous friction forwards above its mean of both directions"
    )
}
"""Effects that the rig cannot hide, because they need another load."""

EVERY_EFFECT: Final[dict[str, Row]] = CATALOGUE | BEYOND_THE_RIG
"""Every effect that a plant may have."""


def effect_and_joint(hidden: str) -> tuple[str, int | None]:
    """Effect and joint of `NAME:JOINT`; the joint is None for `NAME` alone."""
    effect, colon, joint = hidden.partition(":")
    if not colon:
        return effect, None
    if joint not in ("1", "2"):
        raise InputError(f"--hide {hidden}", f"{joint!r} is no joint", f"write {effect}:1 or :2")
    return effect, int(joint)


def parse_strengths(arguments: Sequence[str]) -> dict[str, float]:
    """Strengths by effect, from every `--hide NAME=STRENGTH` or `NAME:JOINT=STRENGTH`."""
    strengths: dict[str, float] = {}
    for argument in arguments:
        where = f"--hide {argument}"
        name, _, value = argument.partition("=")
        effect, _ = effect_and_joint(name)
        if effect not in CATALOGUE:
            remedy = "choose from " + ", ".join(CATALOGUE)
            raise InputError(where, f"{effect!r} is no effect", remedy)
        try:
            strength = float(value)
        except ValueError:
            remedy = f"write {name}=STRENGTH with STRENGTH in {CATALOGUE[effect].unit}"
            raise InputError(where, f"{value!r} is not a number", remedy) from None
        if name in strengths:
            raise InputError(where, "hides the same effect twice", "add them up")
        if not math.isfinite(strength):
            raise InputError(where, "is not finite", "give a finite strength")
        strengths[name] = strength
    return strengths
