"""Current that the servo's register holds when the robot reads it.

It is sampled at the tick, at a phase of the period before, or averaged over that period: servos
read and filter their current in a cycle of their own.
"""

from __future__ import annotations

from collections import deque

from firmware_py.signals import PERIOD_S
from models.rig.rig_parameters import RigParameters


class CurrentRegister:
    """Samples of the current over the last control period."""

    def __init__(self, parameters: RigParameters, step_s: float) -> None:
        sampling = parameters.structure.current_sampling
        steps = PERIOD_S / step_s
        kept = {"tick": 0.0, "phase": parameters["sensor.current_phase"] * steps, "mean": steps - 1}
        self._mean = sampling == "mean"
        self._window: deque[float] = deque([0.0], maxlen=round(kept[sampling]) + 1)
        self.hold = self._window.append
        """Call it with the current in A after each step."""

    @property
    def value_a(self) -> float:
        """Current in A that the register holds."""
        if self._mean:
            return sum(self._window) / len(self._window)
        return self._window[0]
