"""Base of a load: the mechanism that the joints move."""

from __future__ import annotations

from typing import ClassVar

from models.plant.parameter import Parameter
from models.plant.scope import ROTARY, Expr, Scope
from models.plant.step_model import Variable


class PlantLoad:
    """Load of one or two joints; the methods here are those of a rigid load on one joint.

    Attributes
    ----------
    kind : str
        Name in a plant document.
    max_dof : int
        Largest number of joints.
    features : tuple of str
        Features that effects may need (`models.plant.effects.Need`).
    suffix : dict
        Unit suffixes of names, `ROTARY` or `LINEAR`.
    """

    kind: ClassVar[str]
    max_dof: ClassVar[int] = 1
    features: ClassVar[tuple[str, ...]] = ()
    suffix: ClassVar[dict[str, str]] = ROTARY

    def parameters(self, scope: Scope) -> list[Parameter]:
        raise NotImplementedError

    def declare(self, scope: Scope) -> None:
        """Add the states of the load, and its bends if any."""

    def apply_elastic_torques(self, scope: Scope) -> None:
        """Set `bend_torque` to the elastic torque on each bend."""

    def apply_limit(self, scope: Scope) -> None:
        """Bound `bend_torque`, with what effects have added; add the viscous torque."""

    def apply_transmitted_torque(self, scope: Scope) -> None:
        """Set `transmitted_torque`: other torque on each joint, less that of the load.

        A torque on the joint that also bends the root is in both terms and cancels out.
        """
        for j in scope.joints:
            scope.transmitted_torque[j] = scope.joint_torque[j] - scope.bend_torque["root", j]

    def motion_equations(self, scope: Scope) -> tuple[Expr, Expr]:
        """Mass matrix (n, n) and force (n,) over the joints' coordinates and the bends."""
        raise NotImplementedError

    def outputs(self, scope: Scope) -> dict[str, tuple[Variable, Expr]]:
        """Measured quantities of the load by name, without those of the joints."""
        return {}
