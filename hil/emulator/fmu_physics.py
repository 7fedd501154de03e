"""Twin FMU as the plant behind the emulated servos, stepped through ctypes."""

from __future__ import annotations

import weakref
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.errors import FmuRefusal, InputError
from firmware_py.core.signals import tip_names
from firmware_py.inference.fmu_instance import FmuInstance

Array = NDArray[np.float64]


class FmuPhysics:
    """Twin FMU with the interface `hil.emulator.physics.Physics`."""

    def __init__(self, path: Path, dof: int, payload_kg: float = 0.0) -> None:
        self.fmu = FmuInstance(path)
        weakref.finalize(self, self.fmu.close)  # a process may run thousands of cases
        goals = [name for name in self.fmu.variables if name.startswith("goal_")]
        if not goals:
            raise InputError(path, "takes no goals", "build it with --unit twin")
        if len(goals) != dof:
            raise InputError(
                path, f"has {len(goals)} joints, {dof} are needed", "name the twin of the same dof"
            )
        self.dof = dof
        joints = range(1, dof + 1)
        names = [*(f"angle_{j}_rad" for j in joints), *(f"current_{j}_a" for j in joints)]
        self._tick = self.fmu.tick_channel([f"goal_{j}_rad" for j in joints], names)
        self._tip = self.fmu.channel(tip_names())
        self.angle_rad, self.current_a = self._tick.outputs[:dof], self._tick.outputs[dof:]
        try:
            self.fmu.set(["payload_kg"], [payload_kg])
        except FmuRefusal as refusal:
            raise InputError(
                "--payload-kg", str(refusal).rstrip("."), "choose one within the twin's bounds"
            ) from None
        self.fmu.start()
        self._tick.run(0.0)

    @property
    def tip_m(self) -> Array:
        """Tip in the world frame, shape (3,)."""
        self._tip.receive()
        return self._tip.values

    def advance(self, goal_rad: Sequence[float], step_s: float) -> None:
        self._tick.inputs[:] = goal_rad
        self._tick.run(step_s)

    def parameter(self, name: str) -> float:
        """Return a plant parameter."""
        return float(self.fmu.get([f"parameters.{name}"])[0])
