"""Interface of a rig to the study's protocol, and the engines that implement it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from firmware_py.errors import InputError
from models.rig.parameters import RigParameters
from models.rig.trial_case import DOWN, LinkState
from models.shared.kinematics import Array


class ServoSignals(Protocol):
    """Signals of one servo before sensor errors."""

    @property
    def encoder_rad(self) -> float:
        """Angle that encoder and firmware read, before quantisation."""
        ...

    @property
    def sampled_current_a(self) -> float:
        """Motor current as the servo samples it for its register, before sensor errors."""
        ...


class Rig(Protocol):
    """Simulated robot, at rest and upright at the start.

    An engine is a class whose constructor takes the arguments of `build_rig`. It simulates the
    hidden effects by the parameters that `RigParameters.effects` names. The drives take their forms
    from `models.rig.servo.RigServo`, one for each driven joint.
    """

    @property
    def step_s(self) -> float:
        """Integration step in s, an integer fraction of the control period."""
        ...

    @property
    def time_s(self) -> float:
        """Time since the start in s."""
        ...

    @property
    def servos(self) -> Sequence[ServoSignals]:
        """One per driven joint."""
        ...

    @property
    def markers_m(self) -> Array:
        """True markers in the world frame, shape (markers, 3), at the start of the last step.

        In the order m01, m02, … of `docs/trials.md`. The next step may change the array.
        """
        ...

    def look(self) -> LinkState:
        """Whether the link is intact, has folded, or its simulation has become unstable.

        Call it once per control period.
        """
        ...

    def start_leak(self) -> None:
        """Start the pressure leak, at the start of the recorded run."""
        ...

    def send(self, goal_rad: Array) -> None:
        """Send goals in rad, shape (dof,), to the servos."""
        ...

    def step(self) -> None:
        """Advance by one integration step."""
        ...


def build_rig(
    parameters: RigParameters,
    dof: int,
    payload_kg: float,
    eccentricity_m: tuple[float, float] = (0.0, 0.0),
    gravity: tuple[float, float, float] = DOWN,
) -> Rig:
    """Build the engine that the rig's structure names.

    `eccentricity_m` is the offset of the payload's centre from the axis, towards +x and +y.
    `gravity` is a direction in the world frame; its length does not matter.
    """
    for joint in (j for j in parameters.added_in_joint if j > dof):
        raise InputError(
            "--hide EFFECT:JOINT", f"names joint {joint}, and {dof} is driven", "name joint 1"
        )
    # An engine is loaded when it is built: each has a large library of its own.
    if parameters.structure.engine == "cosserat":
        from models.rig.rod import CosseratRig

        return CosseratRig(parameters, dof, payload_kg, eccentricity_m, gravity)
    from models.rig.hinged import MujocoRig

    return MujocoRig(parameters, dof, payload_kg, eccentricity_m, gravity)
