"""Checks on the robot: how to see whether an effect is there.

A look at the robot often decides sooner than a further trial, and it tells look-alikes apart.
"""

from __future__ import annotations

from typing import Final

from models.gap.decision.certainty import DECIDED
from models.gap.report.gap_json import GapDocument, RefusedEffects
from models.shared.catalogue import effect_and_joint

EFFECT_CHECKS: Final[dict[str, str]] = {
    "coulomb_friction":
        "Turn the joint by hand with the torque off, and look for a seal or cable that rubs.",
    "viscous_friction":
        "Compare a cold run with a warm one: thick grease drags in proportion to the rate.",
    "stribeck_friction":
        "Reverse slowly and compare the current near standstill with that at speed.",
    "stiction":
        "Let the joint stand for some seconds and start slowly: it breaks away with a jerk.",
    "load_dependent_friction":
        "Compare the current up and down at each payload: the gear loses more under load.",
    "cogging":
        "Turn slowly through some periods: the current ripples at the same angles each time.",
    "backlash": "Hold the servo and move the tip by hand to and fro; tighten the mount.",
    "joint_elasticity":
        "Hold the servo and load the tip sideways; tighten the screws of horn and mount.",
    "dead_time":
        "Check baud rate, latency timer of the USB adapter and the host's work before it sends.",
    "position_gain_change":
        "Compare the position P gain of the servo with that of the plant's trials "
        "(`gains` in robot.toml: the loop then refuses another one).",
    "current_saturation": "Read the current limit of the servo.",
    "torque_constant_drift":
        "Let the motor cool down and repeat a trial: warm magnets lose torque.",
    "unmodelled_payload": "Weigh the payload with its fixture.",
    "payload_offset": "Measure how far the payload's centre of mass is off the link's axis.",
    "prebend":
        "Look along the unloaded link: it is bent. Mount it anew, or identify the plant with it.",
    "directional_stiffness":
        "Load the tip by the same weight to either side and compare the deflections.",
    "stiffness_softening":
        "Load the tip by one weight and by two: the deflection grows more than twice.",
    "stiffness_hardening":
        "Load the tip by one weight and by two: the deflection grows less than twice.",
    "pressure_leak": "Read the pressure before and after a run.",
    "hysteresis": "Load and unload the tip: it does not return to where it was.",
    "creep": "Load the tip for a minute: it moves on, and returns as slowly.",
    "aerodynamic_drag": "Repeat a trial at half the rate: drag falls to a quarter.",
    "cross_axis_coupling":
        "Load the tip in one plane: it moves in the other. Look how the link sits in its mount.",
    "encoder_offset":
        "Drive to zero and hold a level to the joint and to the base: a base that leans looks "
        "the same. Read the homing offset of the servo.",
    "encoder_ripple":
        "Turn slowly and compare the encoder with the motion capture, angle by angle.",
    "load_offset": "Look for a cable or hose that pulls to one side.",
    "current_bias": "Read the current with the torque off: it is not zero.",
    "current_scale":
        "Check the unit of the current for this model of servo, or measure it with a clamp.",
    "marker_frame_tilt": "Calibrate the frame of the motion capture anew, with a level.",
    "marker_scale":
        "Measure a known length with the motion capture, and repeat its wand calibration.",
    "sync_offset": "Knock on the link: servo and motion capture show it in different rows.",
    "sensor_lag": "Look for a filter of the current in the servo or in the log.",
    "directional_friction": "Compare the force forwards with that backwards at the same rate.",
}  # fmt: skip
"""Check by effect of `models.shared.catalogue.EVERY_EFFECT`. A sentence that states an observation
describes what you see if the effect is there."""

GENERAL_CHECK: Final = (
    "Change it on the robot on purpose, or take its cause away, and record a trial again."
)
"""Check of an effect that has no sentence of its own, such as one in a file of the user."""
MOST_CHECKS: Final = 5
"""Most effects that are listed."""


def standing_out(document: GapDocument) -> list[RefusedEffects]:
    """Effects that stand out and are not named, unless the named ones explain the gap."""
    if document.verdict == "closed":
        return []
    return [row for row in document.refused if row.kind != "not written"]


def effects_to_check(document: GapDocument) -> dict[str, str]:
    """Check of each effect that is named, may be missing, or looks like a named one.

    An effect that may be missing beside the named ones comes last.
    """
    named = [row.effect for row in document.named]
    likely = [e for e, p in document.effect_probabilities.items() if p > 1 - DECIDED]
    alike = [e for row in document.named for other in row.look_alikes for e in other.effects]
    refused = [e for row in standing_out(document) for e in row.effects]
    order = dict.fromkeys(effect_and_joint(e)[0] for e in (*named, *likely, *alike, *refused))
    return {e: EFFECT_CHECKS.get(e, GENERAL_CHECK) for e in list(order)[:MOST_CHECKS]}
