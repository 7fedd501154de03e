"""Polynomial of the paper: angles, currents and Deformation Index."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from firmware_py.signals import feature_names
from models.tip.candidates.polynomial_tip import PolynomialTip

__all__ = ["PaperPolynomial"]


class PaperPolynomial(PolynomialTip):
    """The paper's polynomial of angles, currents and DI (equations 2 and 3)."""

    name: ClassVar[str] = "paper polynomial"
    summary: ClassVar[str] = "the paper's polynomial of angles, currents and DI"
    variants: ClassVar[tuple[int, ...]] = (1, 2, 3, 4, 5, 6)
    corrects: ClassVar[bool] = False

    def chosen(self, dof: int) -> Sequence[str]:
        return feature_names(dof)
