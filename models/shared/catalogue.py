"""Catalogue of physical effects: port, strength, and how to see them on the robot.

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
    size: float  # Strength that would be noticed on the bench; NaN if the rig cannot hide it
    check: str  # How to see on the robot whether it is there; an observation is what you see then


CATALOGUE: Final[dict[str, Row]] = {
    "coulomb_friction": Row(
        "servo_torque", "N.m", "dry friction torque at the output", 2,
        "Turn the joint by hand with the torque off, and look for a seal or cable that rubs.",
    ),
    "viscous_friction": Row(
        "servo_torque", "N.m.s/rad", "friction torque per joint rate", 3,
        "Compare a cold run with a warm one: thick grease drags in proportion to the rate.",
    ),
    "stribeck_friction": Row(
        "servo_torque", "N.m", "extra friction near standstill", 3,
        "Reverse slowly and compare the current near standstill with that at speed.",
    ),
    "stiction": Row(
        "servo_torque", "N.m", "breakaway torque above sliding friction", 3,
        "Let the joint stand for some seconds and start slowly: it breaks away with a jerk.",
    ),
    "load_dependent_friction": Row(
        "servo_torque", "1", "friction per transmitted torque", 0.08,
        "Compare the current up and down at each payload: the gear loses more under load.",
    ),
    "cogging": Row(
        "servo_torque", "N.m", "amplitude of the torque periodic in the angle", 2,
        "Turn slowly through some periods: the current ripples at the same angles each time.",
    ),
    "backlash": Row(
        "servo_torque", "rad", "full backlash of the gear", 0.006,
        "Hold the servo and move the tip by hand to and fro; tighten the mount.",
    ),
    "joint_elasticity": Row(
        "servo_torque", "rad/(N.m)", "gear wind-up per torque", 0.0005,
        "Hold the servo and load the tip sideways; tighten the screws of horn and mount.",
    ),
    "dead_time": Row(
        "command", "s", "delay of the goal on its way to the servo's loop", 0.03,
        "Check baud rate, latency timer of the USB adapter and the host's work before it sends.",
    ),
    "position_gain_change": Row(
        "command", "1", "relative change of the position loop's gain", 0.2,
        "Compare the position P gain of the servo with that of the plant's trials (`gains` in "
        "robot.toml: the loop then refuses another one).",
    ),
    "current_saturation": Row(
        "command", "A", "reduction of the current limit", 7,
        "Read the current limit of the servo.",
    ),
    "torque_constant_drift": Row(
        "servo_torque", "1", "relative loss of torque per ampere", 0.1,
        "Let the motor cool down and repeat a trial: warm magnets lose torque.",
    ),
    "unmodelled_payload": Row(
        "mass", "kg", "mass at the tip beyond the declared payload", 0.3,
        "Weigh the payload with its fixture.",
    ),
    "payload_offset": Row(
        "mass", "1", "payload's offset towards +x per link length", 0.03,
        "Measure how far the payload's centre of mass is off the link's axis.",
    ),
    "prebend": Row(
        "bend_torque", "rad", "bend of the unloaded link towards +x", 0.03,
        "Look along the unloaded link: it is bent. Mount it anew, or identify the plant with it.",
    ),
    "directional_stiffness": Row(
        "stiffness", "1", "stiffer for positive bend, softer else", 0.15,
        "Load the tip by the same weight to either side and compare the deflections.",
    ),
    "stiffness_softening": Row(
        "stiffness", "1", "stiffness lost at 0.1 rad of bend", 0.15,
        "Load the tip by one weight and by two: the deflection grows more than twice.",
    ),
    "stiffness_hardening": Row(
        "stiffness", "1", "stiffness gained at 0.1 rad of bend", 0.3,
        "Load the tip by one weight and by two: the deflection grows less than twice.",
    ),
    "pressure_leak": Row(
        "stiffness", "1", "fraction of stiffness lost per 10 s", 0.1,
        "Read the pressure before and after a run.",
    ),
    "hysteresis": Row(
        "bend_torque", "1", "Bouc-Wen fraction of the bending stiffness", 0.3,
        "Load and unload the tip: it does not return to where it was.",
    ),
    "creep": Row(
        "bend_torque", "1", "relaxing fraction of the stiffness", 0.3,
        "Load the tip for a minute: it moves on, and returns as slowly.",
    ),
    "aerodynamic_drag": Row(
        "joint_torque", "N.m", "drag torque at 1 rad/s, quadratic", 2,
        "Repeat a trial at half the rate: drag falls to a quarter.",
    ),
    "cross_axis_coupling": Row(
        "bend_torque", "1", "torque of one plane per other plane's", 0.2,
        "Load the tip in one plane: it moves in the other. Look how the link sits in its mount.",
    ),
    "encoder_offset": Row(
        "sensor", "rad", "constant error of the measured angle, which the servo controls", 0.02,
        "Drive to zero and hold a level to the joint and to the base: a base that leans looks the "
        "same. Read the homing offset of the servo.",
    ),
    "encoder_ripple": Row(
        "sensor", "rad", "amplitude of the encoder's periodic error", 0.004,
        "Turn slowly and compare the encoder with the motion capture, angle by angle.",
    ),
    "load_offset": Row(
        "joint_torque", "N.m", "constant torque on the joint", 3,
        "Look for a cable or hose that pulls to one side.",
    ),
    "current_bias": Row(
        "sensor", "A", "constant error of the measured current", 0.2,
        "Read the current with the torque off: it is not zero.",
    ),
    "current_scale": Row(
        "sensor", "1", "relative error of the measured current", 0.1,
        "Check the unit of the current for this model of servo, or measure it with a clamp.",
    ),
    "marker_frame_tilt": Row(
        "sensor", "rad", "tilt of the mocap frame about y", 0.015,
        "Calibrate the frame of the motion capture anew, with a level.",
    ),
    "marker_scale": Row(
        "sensor", "1", "relative error of the mocap's scale", 0.01,
        "Measure a known length with the motion capture, and repeat its wand calibration.",
    ),
    "sync_offset": Row(
        "sensor", "s", "delay of the mocap behind the servo", 0.03,
        "Knock on the link: servo and motion capture show it in different rows.",
    ),
    "sensor_lag": Row(
        "sensor", "s", "low-pass time of the measured current", 0.02,
        "Look for a filter of the current in the servo or in the log.",
    ),
}  # fmt: skip

BEYOND_THE_RIG: Final[dict[str, Row]] = {
    "directional_friction": Row(
        "servo_torque", "N.m.s/rad",
        "viscous friction forwards above its mean of both directions", math.nan,
        "Compare the force forwards with that backwards at the same rate.",
    ),
}  # fmt: skip
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
