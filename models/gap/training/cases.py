"""Data sets with effects hidden in the rig, drawn at random.

The rig has its own formulation of every effect. Its stiffness, mass and damping are drawn anew in
each case, so that the plant is never nominally right: it was identified on another link. With
`same_link` they stay: the robot is the one that the plant was identified on. Strengths are
drawn log-uniformly within a factor of two around what would be noticed on the bench (`TYPICAL`), or
around a fifth of it.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, Literal

import numpy as np

from firmware_py.motion import Motion
from models.rig.drawn import LINK_DEVIATION
from models.shared.catalogue import CATALOGUE

DEFAULT_RIG: Final = "default"

PAYLOADS_KG: Final = (0.0, 1.0, 2.0)
"""Payloads of the trials of a case, and of those that a plant is identified on."""

PAYLOAD_SETS: Final = {"study": PAYLOADS_KG, "between": (0.5, 1.5)}
"""Payloads of the trials by name; a plant is identified on the study's."""

MOTIONS: Final = {
    "study": Motion(),
    "small": Motion(amplitude_rad=0.105),
    "slow": Motion(amplitude_rad=0.35, period_s=6.0),
    "multisine": Motion("multisine", amplitude_rad=0.44),
    "triangle": Motion("triangle", period_s=4.0),
}
"""Motions of the trials by name; a plant is identified on the motion that it is diagnosed on. The
workflow was set on the study's; the others are what a user may run [chosen before any run]."""

Kind = Literal["single", "null", "pair", "outside"]

TYPICAL: Final = {
    name: CATALOGUE[name].size
    for name in (
        "coulomb_friction", "viscous_friction", "stribeck_friction", "load_dependent_friction",
        "backlash", "joint_elasticity", "dead_time", "current_saturation", "torque_constant_drift",
        "unmodelled_payload", "payload_offset", "prebend", "directional_stiffness",
        "stiffness_softening", "stiffness_hardening", "pressure_leak", "hysteresis", "creep",
        "aerodynamic_drag", "encoder_offset", "load_offset", "current_bias", "current_scale",
        "marker_frame_tilt", "sync_offset", "sensor_lag", "encoder_ripple", "cogging",
        "marker_scale", "stiction", "position_gain_change",
    )
}  # fmt: skip
"""Strength that matters, in the order of the draw [chosen before any run]."""

TYPICAL_OF_TWO_JOINTS: Final = TYPICAL | {
    "cross_axis_coupling": CATALOGUE["cross_axis_coupling"].size
}  # fmt: skip
"""The same for two joints; only these couple the planes of bending."""

USUAL_SIZE: Final = 1.0
FAINT_SIZE: Final = 0.4
"""Sizes of the effects, as a fraction of what matters (`TYPICAL`)."""

SIGNED: Final = {
    "torque_constant_drift", "payload_offset", "prebend", "directional_stiffness",
    "encoder_offset", "load_offset", "current_bias", "current_scale", "marker_frame_tilt",
    "sync_offset", "encoder_ripple", "cogging", "marker_scale", "cross_axis_coupling",
    "position_gain_change",
}  # fmt: skip

FRAME_TURN_RAD: Final = 0.0005
"""Standard deviation of the turn of a mocap frame that is set up anew, about each axis: 0.1 mm over
the 0.2 m of a calibration square [assumed]."""


@dataclass(frozen=True)
class HiddenCase:
    """One data set."""

    kind: Kind  # One effect, none, two, or one that the catalogue is denied
    hidden: dict[str, float]
    nuisance: dict[str, float]  # Factors on the rig's parameters
    seed: int  # Of trial variation and noise
    rig: str = DEFAULT_RIG
    joints: int = 1
    # Turn of the mocap frame since the plant was identified: roll, tilt, yaw (none if empty)
    frame_turn_rad: dict[str, float] = field(default_factory=dict)


def motion_named(name: str, joints: int) -> Motion:
    return replace(MOTIONS[name], dof=joints)


def drawn_case(
    rng: np.random.Generator,
    kind: Kind,
    hidden: Sequence[tuple[str, float]],
    rig: str,
    same_link: bool,
    joints: int = 1,
) -> HiddenCase:
    """Draw one case.

    `hidden`: effects, each with its size: 1 is about what matters (`TYPICAL`).
    `same_link`: whether the link is the one that the plant was identified on.
    """
    nuisance = {n: float(np.exp(s * rng.standard_normal())) for n, s in LINK_DEVIATION.items()}
    strengths = {e: _strength(rng, e, size) for e, size in hidden}
    nuisance = {} if same_link else nuisance
    seed = int(rng.integers(2**31))
    turns = FRAME_TURN_RAD * np.random.default_rng([seed, 1]).standard_normal(3)
    turn_rad = dict(zip(("roll", "tilt", "yaw"), turns.tolist(), strict=True))
    return HiddenCase(kind, strengths, nuisance, seed, rig, joints, frame_turn_rad=turn_rad)


def hidden_cases(
    rig: str,
    usual: int,
    faint: int,
    nulls: int,
    pairs: int,
    outside: int,
    seed: int,
    same_link: bool,
    joints: int = 1,
    effects: Sequence[str] = (),
) -> Iterator[HiddenCase]:
    """Draw the cases of one rig.

    `usual`, `faint`: data sets with one effect of either size, each with another effect.
    `nulls`, `pairs`, `outside`: without an effect, with two, and with one that the catalogue is
    denied.
    `same_link`: whether the link is the one that the plant was identified on.
    `effects`: effects to draw from; all of the catalogue where it is empty.
    """
    rng = np.random.default_rng([seed, zlib.crc32(rig.encode())])

    def case(kind: Kind, *hidden: tuple[str, float]) -> HiddenCase:
        return drawn_case(rng, kind, hidden, rig, same_link, joints)

    catalogue = list(effects or (TYPICAL_OF_TWO_JOINTS if joints == 2 else TYPICAL))
    names = rng.permutation(catalogue).tolist()
    yield from (case("single", (e, USUAL_SIZE)) for e in names[:usual])
    yield from (case("single", (e, FAINT_SIZE)) for e in names[usual : usual + faint])
    yield from (case("null") for _ in range(nulls))
    for _ in range(pairs):
        first, second = rng.choice(catalogue, 2, replace=False).tolist()
        yield case("pair", (first, USUAL_SIZE), (second, USUAL_SIZE))
    drawn = (str(rng.choice(catalogue)) for _ in range(outside))
    yield from (case("outside", (effect, USUAL_SIZE)) for effect in drawn)


def _strength(rng: np.random.Generator, effect: str, size: float) -> float:
    sign = rng.choice([-1.0, 1.0]) if effect in SIGNED else 1.0
    typical = TYPICAL_OF_TWO_JOINTS[effect]
    if effect == "current_saturation":  # below a threshold it does nothing at all
        return float(rng.uniform(0.85, 1.05)) * typical
    return float(sign * size * typical * 2 ** rng.uniform(-1, 1))
