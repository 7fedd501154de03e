"""Plant behind the emulated servos: a twin FMU, or a rig (`hil.emulator.rig_physics`).

The emulator's process loads neither a compiler nor a computer algebra system: `build_twin` imports
them where it uses them.
"""

from __future__ import annotations

import weakref
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.errors import FmuRefusal, InputError
from firmware_py.core.signals import tip_names
from firmware_py.inference.fmu_instance import FmuInstance, platform_here

Array = NDArray[np.float64]


class Physics(Protocol):
    """Plant behind the servos, including their closed loops."""

    dof: int  # Number of joints, one servo each
    angle_rad: Array  # (dof,), at the end of the last step
    current_a: Array  # (dof,), at the end of the last step

    @property
    def tip_m(self) -> Array:
        """Tip in the world frame at the end of the last step, shape (3,)."""
        ...

    def advance(self, goal_rad: Sequence[float], step_s: float) -> None:
        """Advance by one step with constant goals."""
        ...


@dataclass(frozen=True)
class RigSource:
    """Rig to simulate behind the servos."""

    # Strength of each effect added to the rig, in the unit that `models.shared.catalogue` lists
    hidden: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0  # Seed of the variation between trials and of the current's noise
    # Name of a structure, or a TOML file that changes values (`models.rig.drawn.rig_named`)
    rig: str = "default"
    pressure_pa: float | None = None  # Declared pressure; by default that of the link


def build_twin(plant: Path, dof: int, directory: Path) -> Path:
    """Build the twin FMU of a plant file for this machine, without a predictor."""
    from fmu.fmu_builder import build_fmu
    from fmu.packaging import platform_names
    from models.plant.plant import read_plant

    platforms = platform_names(platform_here())
    model = read_plant(plant).step_model(dof, "twin")
    return build_fmu(model, directory / f"twin_{dof}dof.fmu", platforms=platforms)


class FmuPhysics:
    """Twin FMU as the plant, stepped through ctypes."""

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
        return float(self.fmu.get([f"parameters.{name}"])[0])
