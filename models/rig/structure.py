"""Structure of a rig: the forms of its equations, as opposed to their numbers."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import msgspec

from firmware_py.files.input_files import convert

STRUCTURES: Final = Path(__file__).with_name("structures")
"""Files of the named structures, `NAME.toml`."""


class RigStructure(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Forms of a rig's equations; the defaults are those of the project's rig."""

    # Mechanics of the link: hinges in MuJoCo, or a Cosserat rod
    engine: Literal["mujoco", "cosserat"] = "mujoco"
    # Hinge pairs of the span in MuJoCo, without the root's
    hinges: Annotated[int, msgspec.Meta(ge=5, le=17)] = 8
    # How the elastic moment saturates (`models.rig.hinged`)
    limit: Literal["tanh", "wrinkling"] = "tanh"
    # Friction of the link's skin (`models.rig.forms`)
    hysteresis: Literal["bouc_wen", "maxwell_slip", "dahl"] = "bouc_wen"
    # Spectrum of relaxation times (`models.rig.forms`)
    creep: Literal["branches", "power_law"] = "branches"
    # Friction of the servo (`models.rig.forms`)
    friction: Literal["lugre", "smooth"] = "lugre"
    # How Stribeck friction fades with the rate (`models.rig.servo`)
    stribeck: Literal["gaussian", "rational"] = "gaussian"
    # Where the backlash is: in the gear, or in the link's mount, where it moves only the markers
    # (`models.rig.forms`)
    play: Literal["gear", "markers"] = "gear"
    # Set-point between two goals (`models.rig.forms`)
    goal: Literal["held", "interpolated", "profile"] = "held"
    # Current that the servo's register holds (`models.rig.forms`)
    current_sampling: Literal["tick", "phase", "mean"] = "tick"
    # Position loop: proportional, or also with feed-forward of the goal's rate and an integral of
    # the error (`models.rig.servo`)
    position_loop: Literal["proportional", "feedforward"] = "proportional"
    # Where the velocity loop measures its rate: at the motor, or at the encoder with its periodic
    # error (`models.rig.servo`)
    rate_sensor: Literal["motor", "encoder"] = "motor"
    # Filter in the software of the motion capture (`models.rig.forms`)
    mocap_filter: Literal["none", "low_pass", "zero_phase"] = "none"


DEFAULT_STRUCTURE: Final = RigStructure()


class NamedStructure(msgspec.Struct, frozen=True, kw_only=True):
    """Content of a structure's file, apart from parameters."""

    summary: str  # Description in one line
    # "tuning" if numbers of the workflow may be set on it, "test" if they never are
    purpose: Literal["tuning", "test"]
    structure: RigStructure


def named_structures() -> dict[str, NamedStructure]:
    """Named structures by name, the default first."""
    paths = sorted(STRUCTURES.glob("*.toml"), key=lambda p: (p.stem != "default", p.stem))
    return {p.stem: structure_of(tomllib.loads(p.read_text(encoding="utf-8")), p) for p in paths}


def structure_of(document: dict[str, Any], path: Path) -> NamedStructure:
    """Convert the decoded file of a structure."""
    remedy = "see docs/rig/structures.md for its form"
    return convert(document, NamedStructure, path, "is no structure of a rig", remedy)
