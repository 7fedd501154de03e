"""Polynomial of the observer's signed bend and its rate."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from models.tip.candidates.polynomial_tip import PolynomialTip, motion_names

__all__ = ["BendPolynomial"]


class BendPolynomial(PolynomialTip):
    name: ClassVar[str] = "bend polynomial"
    summary: ClassVar[str] = (
        "a polynomial of the joint angles and the observer's signed bend and its rate"
    )
    variants: ClassVar[tuple[int, ...]] = (2, 3, 4)
    corrects: ClassVar[bool] = False

    def chosen(self, dof: int) -> Sequence[str]:
        return [name for name in motion_names(dof) if not name.startswith("joint_rate")]
