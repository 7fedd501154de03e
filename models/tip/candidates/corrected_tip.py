"""Observer's tip with a polynomial correction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from firmware_py.signals import PAYLOAD
from models.tip.candidates.polynomial_tip import PolynomialTip, motion_names

__all__ = ["CorrectedTip"]


class CorrectedTip(PolynomialTip):
    """Observer's tip with a trained polynomial correction; degree 0 means no correction."""

    name: ClassVar[str] = "corrected observer"
    summary: ClassVar[str] = "the observer's tip with a polynomial correction of motion and payload"
    variants: ClassVar[tuple[int, ...]] = (0, 1, 2)
    corrects: ClassVar[bool] = True

    def chosen(self, dof: int) -> Sequence[str]:
        return (*motion_names(dof), PAYLOAD.name)
