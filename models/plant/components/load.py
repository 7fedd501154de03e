"""Interface of a load: the mechanism that the joints move."""

from __future__ import annotations

from typing import ClassVar, Protocol

from models.plant.parameter import Parameter
from models.plant.scope import Expr, Scope
from models.plant.step_model import Variable


class PlantLoad(Protocol):
    """Load of one or two joints.

    Attributes
    ----------
    kind : str
        Name in a plant document.
    max_dof : int
        Largest number of joints.
    features : tuple of str
        Features that effects may need (`models.plant.effects.Need`).
    suffix : dict
        Unit suffixes of names: `models.plant.scope.ROTARY` or `LINEAR`.
    """

    kind: ClassVar[str]
    max_dof: ClassVar[int]
    features: ClassVar[tuple[str, ...]]
    suffix: ClassVar[dict[str, str]]

    def parameters(self, scope: Scope) -> tuple[Parameter, ...]:
        """Return the parameters for the joints of `scope`."""
        ...

    def declare(self, scope: Scope) -> None:
        """Add the states of the load, and its bends if any."""
        ...

    def apply_elastic_torques(self, scope: Scope) -> None:
        """Set `bend_torque` to the elastic and viscous torque on each bend."""
        ...

    def apply_transmitted_torque(self, scope: Scope) -> None:
        """Set `transmitted_torque` of each joint."""
        ...

    def motion_equations(self, scope: Scope) -> tuple[Expr, Expr]:
        """Return mass matrix (n, n) and force (n,) over the joints' coordinates and the bends."""
        ...

    def outputs(self, scope: Scope) -> dict[str, tuple[Variable, Expr]]:
        """Return the measured quantities of the load by name, without those of the joints."""
        ...
