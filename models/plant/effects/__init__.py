"""Effects: what a plant can have beyond its nominal drive and load.

An effect is one small class in a file of this package: its name in the catalogue, its parameters
(the first is its strength: at zero the plant is exactly the one without it), the states that it
adds, and the quantities of the scope that it changes at its port. A class is registered when it
derives from `Effect`; docs/plant/add-an-effect.md has an example.

The ports are applied one after the other (`PORTS`). Within a port the effects act in the order of
`ORDER`, regardless of the order of their files, classes or entries in a plant document. The
parameters of a composed model have the same order. An effect that is not listed acts after the
listed ones of its port; several such effects act in the order of their names.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Final, Literal

import msgspec

from firmware_py.core.errors import InputError
from models.plant.components.drive import Drive
from models.plant.components.load import PlantLoad
from models.plant.parameter import Parameter
from models.plant.scope import Scope
from models.shared.catalogue import EVERY_EFFECT, Port
from models.trials.units import exponents_in

PORTS: Final[tuple[Port, ...]] = (
    "sensor", "command", "stiffness", "mass", "bend_torque", "joint_torque", "servo_torque",
)  # fmt: skip
"""Order of the ports. Sensors come first because the drive controls the measured angle. Stiffness
and mass come before the torques that depend on them. `servo_torque` is last: friction and wind-up
depend on the torque that the gear transmits, which is known once all other torques are."""

ORDER: Final[tuple[str, ...]] = (
    # The rest shape defines the elastic torque, so it comes before the memory.
    "prebend",
    # Factors on the stiffness of a hinge: their order does not matter.
    "directional_stiffness", "stiffness_softening", "stiffness_hardening", "pressure_leak",
    # The memory adds torque in proportion to the stiffness and the bend itself; the coupling mixes
    # the planes of all torque on a bend, memory, limit and damping included, so it comes last.
    "hysteresis", "creep", "cross_axis_coupling",
    # The goal, the gain and the current limit are separate quantities.
    "dead_time", "position_gain_change", "current_saturation",
    # The torque constant is a factor, each friction and the cogging an addend.
    "torque_constant_drift", "coulomb_friction", "viscous_friction", "directional_friction",
    "stribeck_friction", "stiction", "load_dependent_friction", "cogging",
    # Wind-up and play add up between the drive's side of the gear and the load's.
    "joint_elasticity", "backlash",
    # The mass at the tip and its offset are separate quantities.
    "unmodelled_payload", "payload_offset",
    # Both are addends. Drag also bends the link, after the coupling of the planes.
    "load_offset", "aerodynamic_drag",
    # Sensors: separate quantities.
    "encoder_offset", "encoder_ripple", "current_bias", "current_scale", "marker_frame_tilt",
    "marker_scale", "sync_offset", "sensor_lag",
)  # fmt: skip
"""Order within a port; an effect needs an entry only if it has to act before one of these. Where
two effects do not commute, the comment says why the one comes before the other."""


def in_order(names: Iterable[str]) -> list[str]:
    """Sort names of effects in the order in which they act within a port."""
    place = {name: place for place, name in enumerate(ORDER)}
    return sorted(names, key=lambda name: (place.get(name, len(ORDER)), name))


EFFECTS: Final[dict[str, type[Effect]]] = {}
"""Effects by name; a class is registered by its definition."""

Need = Literal["bend", "gear load", "tip", "current", "current limit", "goal shape",
    "position gain", "smooth friction", "straight guide",
]  # fmt: skip
"""Features of drive or load that an effect may need."""


class Effect:
    """Base of all effects.

    Attributes
    ----------
    name : str
        Name in the catalogue and in a plant document.
    port : str
        Place where it acts; from the catalogue unless the class sets it.
    per_joint : tuple of Parameter
        Parameters of each joint; their names are patterns with {j}, {angle}, {torque}.
    shared : tuple of Parameter
        Parameters that all joints share.
    parameter_needs : mapping of str to str
        Feature that the drive must have, by name of a parameter in `per_joint`.
    needs : tuple of str
        Features that the drive or the load must have.
    of_each_joint : bool
        Whether the strength differs by joint, like the offset of a mounting. All other effects are
        alike in servos of one make; planes of bending differ.
    search_start : mapping of str to float
        Start values of the other parameters in a search for the strength.
    beyond_limit : bool
        Whether an effect of the port `bend_torque` acts on the torque after the link's limit
        moment has bounded it. Any other effect of that port adds to the moment that is bounded.
    fitted_last : tuple of str
        Names in `per_joint` that `identify` does not fit. A search that knows the noise floor fits
        them after the others: fitted at once, with a strength far from the optimum, they lead to
        a local minimum.
    """

    name: ClassVar[str]
    port: ClassVar[Port]
    per_joint: ClassVar[tuple[Parameter, ...]] = ()
    shared: ClassVar[tuple[Parameter, ...]] = ()
    parameter_needs: ClassVar[Mapping[str, Need]] = {}
    needs: ClassVar[tuple[Need, ...]] = ()
    of_each_joint: ClassVar[bool] = False
    search_start: ClassVar[Mapping[str, float]] = {}
    beyond_limit: ClassVar[bool] = False
    fitted_last: ClassVar[tuple[str, ...]] = ()

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        where, ports = f"effect class {cls.__module__}.{cls.__qualname__}", ", ".join(PORTS)
        if not hasattr(cls, "name"):
            raise InputError(where, "has no name", "set name in the class")
        if not hasattr(cls, "port") and cls.name in EVERY_EFFECT:
            cls.port = EVERY_EFFECT[cls.name].port
        if not hasattr(cls, "port"):
            raise InputError(
                where, f"has no port, and the catalogue has no row {cls.name!r}",
                f"set port in the class to one of {ports}",
            )  # fmt: skip
        if cls.port not in PORTS:
            raise InputError(where, f"has the port {cls.port!r}", f"choose from {ports}")
        if not (cls.per_joint or cls.shared):
            raise InputError(where, "has no strength", "give it a Parameter in per_joint or shared")
        EFFECTS[cls.name] = cls

    def parameters(self, scope: Scope) -> tuple[Parameter, ...]:
        """Return the parameters for the joints of `scope`, the strength first."""
        named = [
            _for_joint_kind(q, scope.name(q.name, j), scope)
            for q in self.per_joint
            if q.name not in self.parameter_needs or self.parameter_needs[q.name] in scope.features
            for j in scope.joints
        ]
        return (*named, *(_for_joint_kind(q, scope.name(q.name), scope) for q in self.shared))

    @classmethod
    def strengths(cls, scope: Scope) -> tuple[str, ...]:
        """Return the names of the strength: one per joint of `scope`, or one for all."""
        if cls.per_joint:
            return tuple(scope.name(cls.per_joint[0].name, j) for j in scope.joints)
        return (scope.name(cls.shared[0].name),)

    @classmethod
    def dead_zone_strength(cls, known: Mapping[str, float], trials: Sequence[Any]) -> float:
        """Return the first strength to try for an effect with a dead zone; zero without one.

        `known` holds the plant's parameters by name.
        """
        return 0.0

    def apply(self, scope: Scope) -> None:
        """Change the quantities of the scope at the effect's port."""
        raise NotImplementedError


PULLEY_M: Final = 0.1
"""Pulley radius that converts parameters of a rotary joint to a linear one."""


def _for_joint_kind(q: Parameter, name: str, scope: Scope) -> Parameter:
    """Parameter for a rotary or a linear joint.

    Effects are written for a rotary joint. On a straight guide a torque becomes a force, an inertia
    a mass and an angle a displacement, as for a belt on a pulley; value and bounds are scaled
    accordingly.
    """
    q = msgspec.structs.replace(q, name=name)
    if scope.suffix["angle"] == "rad":
        return q
    powers = exponents_in(f"parameter {name}", q.unit)
    torque, inertia, length = (powers.get(symbol, 0) for symbol in ("N", "kg", "m"))
    # kg.m2 with a time may be a torque or a damping in base units.
    if (torque or inertia) and length and (
        length != torque + 2 * inertia or (inertia and "s" in powers)
    ):  # fmt: skip
        raise InputError(
            f"parameter {name}", f"is in {q.unit}, which has no equivalent on a straight guide",
            "write its unit with N.m for a torque and kg.m2 for an inertia",
        )  # fmt: skip
    levers = length if torque or inertia else 0
    angle = powers.pop("rad", 0)
    powers["m"] = length - levers + angle
    factor = PULLEY_M ** (angle - levers)
    return msgspec.structs.replace(
        q, unit=_spelled(powers), value=q.value * factor, low=q.low * factor, high=q.high * factor
    )


def _spelled(powers: Mapping[str, int]) -> str:
    """Unit with these exponents, in the spelling of FMI."""
    above, below = (
        [s + (str(abs(n)) if abs(n) > 1 else "") for s, n in powers.items() if sign * n > 0]
        for sign in (1, -1)
    )
    divisor = ".".join(below) if len(below) < 2 else f"({'.'.join(below)})"
    return (".".join(above) or "1") + (divisor and f"/{divisor}")


def applicable(drive: type[Drive], load: type[PlantLoad]) -> list[str]:
    """Names of the effects that a plant with this drive and this load can have."""
    has = {*drive.features, *load.features}
    return [name for name in in_order(EFFECTS) if has.issuperset(EFFECTS[name].needs)]


def check_effects(
    where: Path | str, names: Iterable[str], drive: type[Drive], load: type[PlantLoad]
) -> None:
    """Refuse effects that are unknown or that the drive and the load do not allow."""
    known = applicable(drive, load)
    for name in names:
        if name not in known:
            what = f"{name!r} is no effect" if name not in EFFECTS else (
                f"effect {name!r} acts on a {EFFECTS[name].needs[0]}, "
                f"which a {load.kind} on a {drive.kind} drive does not have"
            )  # fmt: skip
            raise InputError(where, what, "choose from " + ", ".join(sorted(known)))


for _module in pkgutil.iter_modules(__path__):
    importlib.import_module(f"{__name__}.{_module.name}")
