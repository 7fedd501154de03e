"""Equation error of the effects: how far a fitted strength is off although its name is correct.

A link has no hinges, and a gear no friction curve of two parameters, so the strength that fits best
is not that of the body. The error was measured on rigs of drawn structure, which have other
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

    strengths: int  # Correctly named effects that it was measured on
    general: float
    port: dict[str, float]
    effect: dict[str, float]

    def fraction(self, effect: str) -> float:
        """Error of an effect's strength: by effect, else by its port, else the mean over all."""
        return self.effect.get(effect, self.port.get(EFFECTS[effect].port, self.general))


def read_equation_error() -> EquationError:
    """Read the measured equation errors."""
    return msgspec.json.decode(PATH.read_bytes(), type=EquationError)
