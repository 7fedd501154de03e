"""Structure of a rig: the choices of formulation, beside its numbers."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import msgspec

from firmware_py.files.input_files import convert

__all__ = ["DEFAULT_STRUCTURE", "NamedStructure", "RigStructure", "named_structures"]

STRUCTURES: Final = Path(__file__).with_name("structures")
"""Files of the named structures, `NAME.toml`."""


class RigStructure(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Choices of formulation; the defaults are those of the project's own rig.

    Attributes
    ----------
    engine : str
        Mechanics of the link: a MuJoCo model of hinges, or a Cosserat rod.
    hinges : int
        Hinge pairs of the span (MuJoCo); the root's pair comes before.
    limit : str
        How the elastic moment levels off (`models.rig.hinged.bending_law`).
    hysteresis : str
        Friction of the link's skin (`models.rig.forms.hysteresis_forms`).
    creep : str
        Spectrum of relaxation (`models.rig.forms.creep_forms`).
    friction : str
        Friction of the servo (`models.rig.forms.friction_forms`).
    stribeck : str
        How Stribeck friction fades with the rate (`models.rig.rig_servo`).
    play : str
        Backlash inside the gear, or in the link's mount, where markers alone show it
        (`models.rig.forms.marker_play`).
    goal : str
        Set-point between two goals (`models.rig.forms.goal_forms`).
    current_sampling : str
        Current that the servo's register holds (`models.rig.forms.current_sampling`).
    position_loop : str
        Proportional, or with feed-forward of the goal's rate and an integral of the error
        (`models.rig.rig_servo`).
    rate_sensor : str
        Where the velocity loop measures its rate: at the motor, or with the encoder, whose
        periodic error is then in it (`models.rig.rig_servo`).
    mocap_filter : str
        Filter of the motion capture's software (`models.rig.forms.mocap_filter`).
    """

    engine: Literal["mujoco", "cosserat"] = "mujoco"
    hinges: Annotated[int, msgspec.Meta(ge=5, le=17)] = 8
    limit: Literal["tanh", "wrinkling"] = "tanh"
    hysteresis: Literal["bouc_wen", "maxwell_slip", "dahl"] = "bouc_wen"
    creep: Literal["branches", "power_law"] = "branches"
    friction: Literal["lugre", "smooth"] = "lugre"
    stribeck: Literal["gaussian", "rational"] = "gaussian"
    play: Literal["gear", "markers"] = "gear"
    goal: Literal["held", "interpolated", "profile"] = "held"
    current_sampling: Literal["tick", "phase", "mean"] = "tick"
    position_loop: Literal["proportional", "feedforward"] = "proportional"
    rate_sensor: Literal["motor", "encoder"] = "motor"
    mocap_filter: Literal["none", "low_pass", "zero_phase"] = "none"


DEFAULT_STRUCTURE: Final = RigStructure()


class NamedStructure(msgspec.Struct, frozen=True, kw_only=True):
    """Head of the file of a structure.

    Attributes
    ----------
    summary : str
        One line for people.
    purpose : str
        "tuning" where numbers of the workflow may be set on it, "test" where they never are.
    structure : RigStructure
        Its choices.
    """

    summary: str
    purpose: Literal["tuning", "test"]
    structure: RigStructure


def named_structures() -> dict[str, NamedStructure]:
    """Named structures by name, the default first.

    Raises
    ------
    InputError
        If a file is damaged.

    Examples
    --------
    >>> next(iter(named_structures()))
    'default'
    """
    paths = sorted(STRUCTURES.glob("*.toml"), key=lambda p: (p.stem != "default", p.stem))
    return {p.stem: structure_of(tomllib.loads(p.read_text(encoding="utf-8")), p) for p in paths}


def structure_of(document: dict[str, Any], path: Path) -> NamedStructure:
    """Head of the file of a structure.

    Parameters
    ----------
    document : dict
        The TOML file.
    path : Path
        Named in errors.

    Raises
    ------
    InputError
        If summary, purpose or a choice is missing, unknown or malformed.
    """
    remedy = "see docs/rig/structures.md for its form"
    return convert(document, NamedStructure, path, "is no structure of a rig", remedy)
