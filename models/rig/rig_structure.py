"""Structure of a rig: the choices of formulation, beside its numbers."""

from __future__ import annotations

from typing import Final, Literal

import msgspec

__all__ = ["DEFAULT_STRUCTURE", "RigStructure"]


class RigStructure(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Choices of formulation; the defaults are those of the project's own rig.

    Attributes
    ----------
    engine : str
        Mechanics of the link: a MuJoCo model of hinges, or a Cosserat rod.
    """

    engine: Literal["mujoco", "cosserat"] = "mujoco"


DEFAULT_STRUCTURE: Final = RigStructure()
