"""Error of the equations of the effects: how far a strength is off though its name is right.

A link has no hinges, and a gear no friction curve of two parameters: the strength that fits best is
not that of the body. By how much was measured on rigs of drawn structure, which have other
equations (`python -m models.gap.training strengths`); `equation_error.json` holds it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import msgspec

from models.plant.effects import EFFECTS

PATH: Final = Path(__file__).with_name("equation_error.json")


class EquationError(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Root mean square error of strengths beyond chance, as a fraction of the strength."""

    strengths: int  # Rightly named effects that it was measured on
    general: float
    port: dict[str, float]
    effect: dict[str, float]

    def fraction(self, effect: str) -> float:
        """Error of an effect's strength: its own, that of its port, or that of all."""
        return self.effect.get(effect, self.port.get(EFFECTS[effect].port, self.general))


def read_equation_error() -> EquationError:
    """Errors in use."""
    return msgspec.json.decode(PATH.read_bytes(), type=EquationError)
