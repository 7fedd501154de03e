"""Order in which the effects of one port act.

The ports are applied one after the other (`PORTS`). Within a port the effects act in the order of
`ORDER`, regardless of the order of their files, classes or entries in a plant document. The
parameters of a composed model have the same order. An effect that is not listed acts after the
listed ones of its port; several such effects act in the order of their names.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from models.shared.catalogue import Port

PORTS: Final[tuple[Port, ...]] = (
    "sensor", "command", "stiffness", "mass", "bend_torque", "joint_torque", "servo_torque",
)  # fmt: skip
"""Order of the ports. Sensors come first because the drive controls the measured angle. Stiffness
and mass come before the torques that depend on them. `servo_torque` is last: friction and wind-up
depend on the torque that the gear transmits, which is known once all other torques are."""

ORDER: Final[tuple[str, ...]] = (
    # bend_torque: the rest shape defines the elastic torque, so `prebend` comes before the memory.
    "prebend",
    # stiffness: all four are factors on the stiffness of a hinge, so their order does not matter.
    "directional_stiffness",
    "stiffness_softening",
    "stiffness_hardening",
    "pressure_leak",
    # bend_torque: the memory adds torque in proportion to the stiffness and the bend itself; the
    # coupling mixes the planes of all torque on a bend, memory included, so it comes last.
    "hysteresis",
    "creep",
    "cross_axis_coupling",
    # command: the goal, the gain and the current limit are separate quantities.
    "dead_time",
    "position_gain_change",
    "current_saturation",
    # servo_torque: the torque constant is a factor, each friction and the cogging an addend.
    "torque_constant_drift",
    "coulomb_friction",
    "viscous_friction",
    "directional_friction",
    "stribeck_friction",
    "stiction",
    "load_dependent_friction",
    "cogging",
    # servo_torque: wind-up and play add up between the drive's side of the gear and the load's.
    "joint_elasticity",
    "backlash",
    # mass: the mass at the tip and its offset are separate quantities.
    "unmodelled_payload",
    "payload_offset",
    # joint_torque: both are addends. Drag also bends the link, after the coupling of the planes.
    "load_offset",
    "aerodynamic_drag",
    # sensor: separate quantities.
    "encoder_offset",
    "encoder_ripple",
    "current_bias",
    "current_scale",
    "marker_frame_tilt",
    "marker_scale",
    "sync_offset",
    "sensor_lag",
)
"""Every effect of the catalogue. Where two effects of a port do not commute, the comment says why
the one comes before the other."""

_PLACE: Final = {name: place for place, name in enumerate(ORDER)}


def in_order(names: Iterable[str]) -> list[str]:
    """Sort names of effects in the order in which they act within a port."""
    return sorted(names, key=lambda name: (_PLACE.get(name, len(ORDER)), name))
