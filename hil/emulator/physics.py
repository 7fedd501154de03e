"""The plant behind the emulated servos: an FMI unit of a twin, stepped through ctypes.

One form for both sources: `--fmu` names a unit, and `hil.emulator.twin_fmu` builds a plant
document into one.
In a plant's place the laboratory can stand (`hil.emulator.rig_physics`), loaded only where it does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from firmware_py.errors import InputError
from firmware_py.inference.fmu_instance import FmuInstance
from firmware_py.signals import tip_names

if TYPE_CHECKING:
    from hil.emulator.emulated_bus import Physics

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RigSource:
    """A laboratory to put behind the servos.

    Attributes
    ----------
    hidden : mapping of str to float
        Effects added to what it has by default, in the unit that `models.shared.catalogue` lists.
    seed : int
        Of the variation between trials and of the current's noise.
    """

    hidden: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0


def open_physics(source: Path | RigSource, dof: int, payload_kg: float = 0.0) -> Physics:
    """The twin in a .fmu file, or a laboratory, in its initial state.

    Raises
    ------
    InputError
        If it cannot be used.
    """
    if isinstance(source, Path):
        return FmuPhysics(source, dof, payload_kg)
    from hil.emulator.rig_physics import RigPhysics  # loads MuJoCo

    return RigPhysics(source, dof, payload_kg)


class FmuPhysics:
    """A twin as `hil.emulator.emulated_bus.Physics`.

    Parameters
    ----------
    path : Path
        The .fmu file.
    dof : int
        Number of joints that it must have.
    payload_kg : float
        Mass at the tip.

    Raises
    ------
    InputError
        If the file cannot be used, is no twin, or is one of other joints.
    """

    def __init__(self, path: Path, dof: int, payload_kg: float = 0.0) -> None:
        self.unit = FmuInstance(path)
        goals = [name for name in self.unit.variables if name.startswith("goal_")]
        if not goals:
            raise InputError(path, "takes no goals", "build it with --unit twin")
        if len(goals) != dof:
            raise InputError(
                path, f"has {len(goals)} joints, {dof} are needed", "name the unit of the same dof"
            )
        self.dof = dof
        joints = range(1, dof + 1)
        self._goals = self.unit.channel([f"goal_{j}_rad" for j in joints])
        names = [*(f"angle_{j}_rad" for j in joints), *(f"current_{j}_a" for j in joints)]
        self._state = self.unit.channel(names)
        self._tip = self.unit.channel(tip_names())
        self.angle_rad, self.current_a = self._state.values[:dof], self._state.values[dof:]
        self.unit.set(["payload_kg"], [payload_kg])
        self.unit.start()
        self._state.receive()

    @property
    def tip_m(self) -> Array:
        """End effector in the world frame, shape (3,)."""
        self._tip.receive()
        return self._tip.values

    def advance(self, goal_rad: Sequence[float], step_s: float) -> None:
        """See `hil.emulator.emulated_bus.Physics.advance`."""
        self._goals.values[:] = goal_rad
        self._goals.send()
        self.unit.step(step_s)
        self._state.receive()

    def parameter(self, name: str) -> float:
        """Value of a plant parameter."""
        return float(self.unit.get([f"parameters.{name}"])[0])
