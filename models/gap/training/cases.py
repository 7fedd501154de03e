"""Data sets with effects hidden in a rig, drawn at random.

The rig has its own formulation of every effect. Its stiffness, mass and damping are drawn anew in
each case, because the plant was identified on another link; with `same_link` they stay. Strengths
are drawn log-uniformly within a factor of two around the catalogue's size, what would be noticed on
the bench, or around a fraction of it.

Every case draws from the seed, its rig and its effects alone. So an effect that is added to the
catalogue leaves the other cases as they are.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Final, Literal

import numpy as np

from firmware_py.core.errors import InputError
from firmware_py.core.motion import Motion
from models.rig.drawn import FIRST_TEST_NUMBER, LINK_DEVIATION, PREFIX, rig_named
from models.rig.parameters import RigParameters
from models.shared.catalogue import CATALOGUE

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
"""Motions of the trials by name; a plant is identified on the study's [chosen before any run]."""
OTHER_MOTIONS: Final = tuple(MOTIONS)[1:]

Kind = Literal["single", "null", "pair", "outside"]

USUAL_SIZE: Final = 1.0
FAINT_SIZE: Final = 0.4
"""Sizes of the effects, as a fraction of the catalogue's."""
SPREAD: Final = 2.0
"""Factor by which a strength may be larger or smaller than its size."""
NARROW: Final = {"current_saturation": (0.85, 1.05)}
"""Range of the factor of effects that do nothing at all below a threshold."""
OF_TWO_JOINTS: Final = {"cross_axis_coupling"}
"""Effects that are hidden with two joints only."""

FRAME_TURN_RAD: Final = 0.0005
"""Standard deviation of the turn of a mocap frame that is set up anew, about each axis: 0.1 mm over
the 0.2 m of a calibration square [assumed]."""

FIRST_TUNING_NUMBER: Final = 600
"""Drawn rigs from this number on give the cases for tuning."""
TUNING_SEED: Final = 67


@dataclass(frozen=True)
class HiddenCase:
    """One data set."""

    kind: Kind  # One effect, none, two, or one that the catalogue is denied
    hidden: dict[str, float]
    nuisance: dict[str, float]  # Factors on the rig's parameters; none on an unchanged link
    seed: int  # Of trial variation and noise
    rig: str
    joints: int = 1
    # Turn of the mocap frame since the plant was identified: roll, tilt, yaw
    frame_turn_rad: dict[str, float] = field(default_factory=dict)
    motion: str = "study"  # In MOTIONS
    payloads: str = "study"  # In PAYLOAD_SETS


def motion_named(name: str, joints: int) -> Motion:
    return replace(MOTIONS[name], dof=joints)


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
) -> Iterator[HiddenCase]:
    """Draw the cases of one rig.

    `usual`, `faint`: data sets with one effect of either size, each with another effect.
    `nulls`, `pairs`, `outside`: without an effect, with two, and with one that the catalogue is
    denied.
    `same_link`: whether the link is the one that the plant was identified on.
    """
    parameters = rig_named(rig)
    catalogue = [
        name for name, row in CATALOGUE.items()
        if name in parameters.effects() and np.isfinite(row.size)
        and (joints > 1 or name not in OF_TWO_JOINTS)
    ]  # fmt: skip

    def drawn(*purpose: str) -> list[str]:
        """Catalogue in an order of its own for each purpose."""
        return sorted(catalogue, key=lambda e: _generator(seed, rig, *purpose, e).random())

    def case(kind: Kind, number: int, size: float, *effects: str) -> HiddenCase:
        rng = _generator(seed, rig, kind, str(number), *effects)
        nuisance = {n: float(np.exp(s * rng.standard_normal())) for n, s in LINK_DEVIATION.items()}
        turns = (FRAME_TURN_RAD * rng.standard_normal(3)).tolist()
        return HiddenCase(
            kind, {e: _strength(rng, parameters, e, size) for e in effects},
            {} if same_link else nuisance, int(rng.integers(2**31)), rig, joints,
            dict(zip(("roll", "tilt", "yaw"), turns, strict=True)),
        )  # fmt: skip

    for k, effect in enumerate(drawn("single")[: usual + faint]):
        yield case("single", 0, USUAL_SIZE if k < usual else FAINT_SIZE, effect)
    yield from (case("null", k, 0.0) for k in range(nulls))
    for k in range(pairs):
        yield case("pair", k, USUAL_SIZE, *drawn("pair", str(k))[:2])
    for k in range(outside):
        yield case("outside", k, USUAL_SIZE, drawn("outside", str(k))[0])


def tuning_cases(number: int) -> list[HiddenCase]:
    """Cases of the drawn rig with a number; refused if it is for testing.

    Every other rig keeps its link. Without an effect each also runs another motion and other
    payloads than its plant was identified on; those with another link also drive two joints.
    """
    if not FIRST_TUNING_NUMBER <= number < FIRST_TEST_NUMBER:
        raise InputError(
            f"{PREFIX}{number}", "is not for tuning",
            f"take rigs from {FIRST_TUNING_NUMBER} to {FIRST_TEST_NUMBER - 1}",
        )  # fmt: skip
    rig = f"{PREFIX}{number}"
    same_link = bool(number % 2)
    # On another link the plant's own error is larger and differs more from rig to rig.
    nulls, pairs = (4, 2) if same_link else (8, 3)
    of_rig = partial(hidden_cases, rig, seed=TUNING_SEED, same_link=same_link)
    cases = list(of_rig(usual=4, faint=2, nulls=nulls, pairs=pairs, outside=2))
    first, second = [case for case in cases if case.kind == "null"][2:4]
    motion = OTHER_MOTIONS[(number // 2 + number // 8) % len(OTHER_MOTIONS)]
    cases[cases.index(first)] = replace(first, motion=motion)
    cases[cases.index(second)] = replace(second, payloads="between")
    if not same_link:
        cases += of_rig(usual=0, faint=0, nulls=3, pairs=0, outside=0, joints=2)
    return cases


def _strength(rng: np.random.Generator, rig: RigParameters, effect: str, size: float) -> float:
    """Strength of an effect; of either sign where the rig allows a negative one."""
    largest = SPREAD * CATALOGUE[effect].size
    signed = rig.entries[rig.effects()[effect]].minimum <= -largest
    sign = rng.choice([-1.0, 1.0]) if signed else 1.0
    if effect in NARROW:
        return float(rng.uniform(*NARROW[effect])) * CATALOGUE[effect].size
    return float(sign * size * CATALOGUE[effect].size * SPREAD ** rng.uniform(-1, 1))


def _generator(seed: int, *words: str) -> np.random.Generator:
    return np.random.default_rng([seed, *(zlib.crc32(word.encode()) for word in words)])
