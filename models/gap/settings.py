"""Settings of the gap workflow: what a user may set. Other numbers stand beside their use."""

from __future__ import annotations

from typing import Final

import msgspec


class GapSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of one diagnosis.

    Examples
    --------
    >>> GapSettings(same_link=True).harm_fraction
    0.05
    """

    same_link: bool = False
    """Whether the link is the one that the plant was identified on, unchanged since. Its stiffness,
    mass and damping are refitted within a third of the usual range then and not written, so fainter
    effects show, as creep and hysteresis."""
    equation_error_fraction: float = 0.1
    """Fraction of its d′ that the equation of a named effect may miss. A further effect must
    explain more than that."""
    harm_fraction: float = 0.05
    """Rise of a signal's held-out error, relative to the plant as given, above which a plant is not
    written."""


DEFAULT_SETTINGS: Final = GapSettings()
