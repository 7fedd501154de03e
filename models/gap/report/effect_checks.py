"""Checks on the robot: how to see whether an effect is there.

A look at the robot often decides sooner than a further trial, and it tells look-alikes apart.
"""

from __future__ import annotations

from typing import Final

from models.gap.decision.further_effect import FurtherEffect
from models.gap.decision.posterior import DECIDED
from models.gap.report.gap_json import GapDocument

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

MOST_CHECKS: Final = 5
"""Most effects that are listed."""


def effects_to_check(document: GapDocument) -> dict[str, str]:
    """Check of each effect that is named, looks like a named one, or is not excluded; most probable
    first.

    The effect that would absorb most of the remaining gap is included.
    """
    known = document.effect_probabilities
    named = [e for row in document.named if row.kept for e in row.effect.split(" + ")]
    alike = [c.effect for row in document.named if row.kept for c in row.look_alikes]
    likely = [e for e, p in sorted(known.items(), key=lambda r: -r[1]) if p > 1 - DECIDED]
    further = further_missing(document)
    left = [further.effect] if further is not None and document.verdict == "reduced" else []
    order = [e for e in dict.fromkeys([*named, *likely, *alike, *left]) if e in EFFECT_CHECKS]
    return {effect: EFFECT_CHECKS[effect] for effect in order[:MOST_CHECKS]}


def further_missing(document: GapDocument) -> FurtherEffect | None:
    """Effect that would explain more beside the named ones than noise and their equation errors."""
    further = document.tested[-1].further if document.tested else None
    return further if further is not None and further.is_missing else None
