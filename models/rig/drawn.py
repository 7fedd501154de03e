"""Rigs drawn at random: structure and values.

A simulation of a robot is wrong in form and in numbers. Rigs of drawn form represent that. Numbers
of the gap workflow are tuned on rigs with numbers below `FIRST_TEST_NUMBER` only (`rig_purpose`).
Some forms are never drawn, only named structures for testing have them: Dahl's hysteresis, the
low-pass filter of a live capture, 5 or 17 hinges, the rod.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final, Literal, NamedTuple

import msgspec
import numpy as np

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import read_toml
from firmware_py.link.link_description import describes_link, read_link
from models.rig.parameters import (
    STRUCTURES,
    RigParameters,
    RigStructure,
    named_structures,
    read_parameters,
    rig_of_link,
)

PREFIX: Final = "drawn_"
SEED: Final = 9000

FIRST_TEST_NUMBER: Final = 900
"""Drawn rigs from this number on are for testing."""


class Range(NamedTuple):
    low: float
    high: float


DRAWN: Final[dict[str, Range | tuple[str | int, ...]]] = {
    "sensor.current_phase": Range(0.2, 1.0),
    "stiffness.directional_share": Range(0.0, 0.3),
    "stiffness.prebend_rad": Range(-0.02, 0.02),
    "hinges": (6, 8, 10, 13),
    "limit": ("tanh", "wrinkling"),
    "hysteresis": ("bouc_wen", "maxwell_slip"),
    "creep": ("branches", "power_law"),
    "friction": ("lugre", "smooth"),
    "play": ("gear", "markers"),
    "goal": ("held", "interpolated", "profile"),
    "current_sampling": ("tick", "phase", "mean"),
    "mocap_filter": ("none", "zero_phase"),
    "rate_sensor": ("motor", "encoder"),
    "position_loop": ("proportional", "proportional", "feedforward"),
    "servo.velocity_feedforward": Range(0.1, 0.9),
    "servo.position_integral_per_s2": Range(0.0, 5.0),
    "stribeck": ("gaussian", "rational"),
}
"""Values and forms (choices of `RigStructure`) that are drawn uniformly, in this order: another
order would change every drawn rig."""

LOG_DEVIATION: Final = {
    "stiffness.bending_n_m2": 0.25, "stiffness.root_nm_rad": 0.25, "stiffness.wall_shear_n": 0.3,
    "stiffness.root_limit_nm": 0.2, "stiffness.span_limit_nm": 0.2, "stiffness.damping_s": 0.3,
    "link.mass_kg": 0.15, "link.tip_mass_kg": 0.15,
    "memory.relaxing_share": 0.3, "memory.relaxation_1_s": 0.4, "memory.relaxation_2_s": 0.4,
    "memory.power_exponent": 0.2, "memory.hysteresis_share": 0.3, "memory.root_yield_rad": 0.3,
    "memory.span_yield_rad": 0.3,
    "servo.coulomb_friction_nm": 0.2, "servo.viscous_friction_nm_s_rad": 0.3,
    "servo.load_friction_share": 0.2, "servo.position_gain_per_s": 0.15,
    "servo.inertia_kg_m2": 0.1, "servo.smooth_rate_rad_s": 0.4, "servo.backlash_rad": 0.3,
    "sensor.mocap_cutoff_hz": 0.2,
}  # fmt: skip
"""Standard deviation of the logarithm of a value between makes of link and servo [assumed]."""

LINK_DEVIATION: Final = {
    "stiffness.bending_n_m2": 0.1, "stiffness.root_nm_rad": 0.1, "link.mass_kg": 0.1,
    "stiffness.damping_s": 0.2,
}  # fmt: skip
"""Standard deviation of the logarithm of a value between two links of a rig [assumed]."""


def rig_named(name: str) -> RigParameters:
    """Return a rig by name.

    Parameters
    ----------
    name : str
        Name of a structure; `drawn_K` for the K-th drawn rig; or a file: of a rig, or of a link
        (`firmware_py.link.link_description`).

    Raises
    ------
    InputError
        If K is not a number, or the file is missing or damaged.

    Examples
    --------
    >>> rig_named("drawn_3").structure == rig_named("drawn_4").structure
    False
    """
    if name.startswith(PREFIX):
        return _drawn_rig(_drawn_number(name))
    path = Path(name)
    if path.is_file() and describes_link(read_toml(path, "name a rig or a link")):
        return rig_of_link(read_link(path), path)
    structure = STRUCTURES / f"{name}.toml"
    return read_parameters(structure if structure.is_file() else path)


def _drawn_rig(number: int) -> RigParameters:
    """Rig drawn around the values of the study's."""
    rig, rng = rig_named("default"), np.random.default_rng([SEED, number])
    values = {
        name: rig[name] * float(np.exp(sigma * rng.standard_normal()))
        for name, sigma in LOG_DEVIATION.items()
    }
    forms: dict[str, str | int] = {}
    for name, among in DRAWN.items():
        if isinstance(among, Range):
            values[name] = float(rng.uniform(among.low, among.high))
        else:
            forms[name] = among[int(rng.integers(len(among)))]
    return replace(rig.changed(**values), structure=msgspec.convert(forms, RigStructure))


def rig_purpose(name: str) -> Literal["tuning", "test"]:
    """Purpose of a rig: "tuning" if numbers of the workflow may be set on it, else "test".

    A rig without a stated purpose, like that of a described link, counts as one for tuning: what
    was set on it is unknown.
    """
    if name.startswith(PREFIX):
        return "test" if _drawn_number(name) >= FIRST_TEST_NUMBER else "tuning"
    named = named_structures()
    return named[name].purpose if name in named else "tuning"


def _drawn_number(name: str) -> int:
    number = name.removeprefix(PREFIX)
    if not number.isdecimal():
        raise InputError(name, "is no drawn rig", f"give a number, as in {PREFIX}3")
    return int(number)
