"""Cases of the benchmark: effects hidden in the rig, drawn at random.

The rig has its own formulation of every effect. Its stiffness, mass and damping are drawn anew in
each case, so that the plant is never nominally right: it was identified on another link. With
`same_link` they stay: the robot is the one that the plant was identified on. Strengths are
drawn log-uniformly within a factor of two around what would be noticed on the bench (`TYPICAL`), or
around a fifth of it.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, Literal, get_args

import numpy as np

from firmware_py.motion import Motion
from models.gap.settings import GapSettings
from models.rig.drawn_rig import LINK_DEVIATION
from models.rig.rig_parameters import RigParameters
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
class BenchCase:
    """One data set."""

    kind: Kind  # One effect, none, two, or one that the catalogue is denied
    hidden: dict[str, float]
    nuisance: dict[str, float]  # Factors on the rig's parameters
    seed: int  # Of trial variation and noise
    rig: str = DEFAULT_RIG
    joints: int = 1
    motion: str = "study"  # Name of the motion of all trials, of `MOTIONS`
    payloads: str = "study"  # Name of their payloads, of `PAYLOAD_SETS`
    # Turn of the mocap frame since the plant was identified: roll, tilt, yaw (none if empty)
    frame_turn_rad: dict[str, float] = field(default_factory=dict)
    told_same_link: bool = False  # Whether the diagnosis is told that the link is the same
    # The only joint whose servo has the effects; None where both have them alike
    joint: int | None = None

    @property
    def added_to_rig(self) -> dict[str, float]:
        """Hidden strengths as `RigParameters.hide` takes them."""
        suffix = "" if self.joint is None else f":{self.joint}"
        return {effect + suffix: strength for effect, strength in self.hidden.items()}

    @property
    def settings(self) -> GapSettings:
        """Settings of the diagnosis."""
        return GapSettings(same_link=self.told_same_link)


def motion_named(name: str, joints: int) -> Motion:
    return replace(MOTIONS[name], dof=joints)


def draw_cases(
    singles: int,
    nulls: int,
    pairs: int,
    outside: int,
    seed: int,
    rig: str = DEFAULT_RIG,
    same_link: bool = False,
    joints: int = 1,
) -> Iterator[BenchCase]:
    """Draw cases; those of each rig differ.

    `nulls`, `pairs`, `outside`: without an effect, with two, and with one that the catalogue is
    denied.
    `same_link`: whether the link is the one that the plant was identified on.
    """
    own = [] if rig == DEFAULT_RIG else [zlib.crc32(rig.encode())]
    rng = np.random.default_rng([seed, *own] if own else seed)
    names = list(TYPICAL_OF_TWO_JOINTS if joints == 2 else TYPICAL)

    def case(kind: Kind, *hidden: tuple[str, float]) -> BenchCase:
        return drawn_case(rng, kind, hidden, rig, same_link, joints)

    for _ in range(singles):
        for size in (1.0, 0.2):
            yield from (case("single", (e, size)) for e in rng.permutation(names).tolist())
    yield from (case("null") for _ in range(nulls))
    for _ in range(pairs):
        first, second = rng.choice(names, 2, replace=False).tolist()
        yield case("pair", (first, 1.0), (second, 1.0))
    yield from (case("outside", (str(rng.choice(names)), 1.0)) for _ in range(outside))


def drawn_case(
    rng: np.random.Generator,
    kind: Kind,
    hidden: Sequence[tuple[str, float]],
    rig: str,
    same_link: bool,
    joints: int = 1,
) -> BenchCase:
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
    return BenchCase(kind, strengths, nuisance, seed, rig, joints, frame_turn_rad=turn_rad)


def in_one_servo(cases: Iterable[BenchCase], rig: RigParameters) -> list[BenchCase]:
    """Cases with two joints whose effects can be in one servo alone, each in a joint drawn for it.

    Cases that hide nothing stay.
    """
    names = rig.effects()
    own = [c for c in cases if all(rig.entries[names[e]].in_one_joint for e in c.hidden)]
    joints = [int(np.random.default_rng([c.seed, 2]).integers(1, 3)) for c in own]
    return [replace(c, joint=j if c.hidden else None) for c, j in zip(own, joints, strict=True)]


def mixed_cases(cases: Sequence[BenchCase], most: int) -> list[BenchCase]:
    """At most so many cases, the kinds in turn: six with one effect to one of each other kind."""
    queues = {kind: [c for c in cases if c.kind == kind] for kind in get_args(Kind)}
    kept: list[BenchCase] = []
    while len(kept) < most and any(queues.values()):
        for kind, queue in queues.items():
            count = 6 if kind == "single" else 1
            kept += queue[:count]
            del queue[:count]
    return kept[:most]


def _strength(rng: np.random.Generator, effect: str, size: float) -> float:
    sign = rng.choice([-1.0, 1.0]) if effect in SIGNED else 1.0
    typical = TYPICAL_OF_TWO_JOINTS[effect]
    if effect == "current_saturation":  # below a threshold it does nothing at all
        return float(rng.uniform(0.85, 1.05)) * typical
    return float(sign * size * typical * 2 ** rng.uniform(-1, 1))
