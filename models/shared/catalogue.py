"""The catalogue of physical effects: names, ports and the unit of their strength.

The rig hides an effect (`models.rig`), the plant holds it (`models.plant.effects`); both in their
own equations. What they share is this table, which is a contract: `--hide NAME=STRENGTH` adds
STRENGTH, in this unit, to what the rig has by default. Strength zero means absent. An effect of the
servo, a joint or a sensor is the same in every driven joint.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, Literal, NamedTuple

from firmware_py.errors import InputError

Port = Literal[
    "command", "servo_torque", "joint_torque", "bend_torque", "stiffness", "mass", "sensor"
]


class EffectName(NamedTuple):
    """One row of the catalogue.

    Attributes
    ----------
    port : str
        Where the effect acts.
    unit : str
        Of its strength (its first parameter); "1" is a share.
    strength : str
        What the strength is.
    """

    port: Port
    unit: str
    strength: str


CATALOGUE: Final[dict[str, EffectName]] = {
    "coulomb_friction": EffectName("servo_torque", "N.m", "dry friction torque at the output"),
    "viscous_friction": EffectName("servo_torque", "N.m.s/rad", "friction torque per joint rate"),
    "stribeck_friction": EffectName("servo_torque", "N.m", "extra friction near standstill"),
    "load_dependent_friction": EffectName("servo_torque", "1", "friction per transmitted torque"),
    "backlash": EffectName("servo_torque", "rad", "full play of the gear"),
    "joint_elasticity": EffectName("servo_torque", "rad/(N.m)", "gear wind-up per torque"),
    "dead_time": EffectName("command", "s", "delay of the goal on its way to the servo's loop"),
    "current_saturation": EffectName("command", "A", "how far the limit lies below the rated one"),
    "torque_constant_drift": EffectName("servo_torque", "1", "relative loss of torque per ampere"),
    "unmodelled_payload": EffectName("mass", "kg", "mass at the tip beyond the declared payload"),
    "payload_offset": EffectName("mass", "1", "payload's offset towards +x, share of link length"),
    "prebend": EffectName("bend_torque", "rad", "bend of the unloaded link towards +x"),
    "directional_stiffness": EffectName("stiffness", "1", "stiffer for positive bend, softer else"),
    "stiffness_softening": EffectName("stiffness", "1", "stiffness lost at 0.1 rad of bend"),
    "stiffness_hardening": EffectName("stiffness", "1", "stiffness gained at 0.1 rad of bend"),
    "pressure_leak": EffectName("stiffness", "1", "share of stiffness lost per 10 s"),
    "hysteresis": EffectName("bend_torque", "1", "Bouc-Wen share of the bending stiffness"),
    "creep": EffectName("bend_torque", "1", "relaxing share of the bending stiffness"),
    "aerodynamic_drag": EffectName("joint_torque", "N.m", "drag torque at 1 rad/s, quadratic"),
    "cross_axis_coupling": EffectName("bend_torque", "1", "torque of one plane per other plane's"),
    "encoder_offset": EffectName("sensor", "rad", "constant error of the encoder, loop included"),
    "load_offset": EffectName("joint_torque", "N.m", "constant torque on the joint"),
    "current_bias": EffectName("sensor", "A", "constant error of the measured current"),
    "current_scale": EffectName("sensor", "1", "relative error of the measured current"),
    "marker_frame_tilt": EffectName("sensor", "rad", "tilt of the mocap frame about y"),
    "sync_offset": EffectName("sensor", "s", "how late the mocap shows what the servo feels"),
}


def parse_strength(argument: str) -> tuple[str, float]:
    """Split `NAME=STRENGTH` as given on a command line.

    Raises
    ------
    InputError
        If the form, the name or the number is wrong.
    """
    name, _, value = argument.partition("=")
    if name not in CATALOGUE:
        raise InputError(
            f"--hide {argument}", f"{name!r} is no effect", "choose from " + ", ".join(CATALOGUE)
        )
    try:
        return name, float(value)
    except ValueError:
        raise InputError(
            f"--hide {argument}",
            f"{value!r} is not a number",
            f"write {name}=STRENGTH with STRENGTH in {CATALOGUE[name].unit}",
        ) from None


def parse_strengths(arguments: Sequence[str]) -> dict[str, float]:
    """Every `--hide EFFECT=STRENGTH` of a command line.

    Raises
    ------
    InputError
        If one is wrong or not finite, or an effect is named twice.
    """
    strengths: dict[str, float] = {}
    for argument in arguments:
        effect, strength = parse_strength(argument)
        if effect in strengths:
            raise InputError(f"--hide {argument}", "hides the same effect twice", "add them up")
        if not math.isfinite(strength):
            raise InputError(f"--hide {argument}", "is not finite", "give a finite strength")
        strengths[effect] = strength
    return strengths
