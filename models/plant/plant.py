"""Plant: drive, load, effects and parameters, composed into step models.

A plant file is read by `read_plant` and written by `Plant.write`; `models.plant.plant_document` has
its form.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Final, Literal

import msgspec

from firmware_py.errors import InputError
from models.plant.components.drives.drive_registry import DRIVES
from models.plant.components.flexible_link import FlexibleLink
from models.plant.components.geared_loads import GearedShaft, GearedSlide
from models.plant.components.link import Link
from models.plant.components.load_protocol import PlantLoad
from models.plant.components.rigid_loads import Mass, Pendulum
from models.plant.composition.driven_link import FOLLOW_RATE, compose_driven
from models.plant.composition.imposed_motion import compose_imposed
from models.plant.composition.observer import compose_observer, observer_parameters
from models.plant.composition.twin import compose_twin
from models.plant.effects import EFFECTS, Effect, applicable, check_effects
from models.plant.effects.order import in_order
from models.plant.parameter import Parameter, check_values
from models.plant.plant_document import (
    EffectEntry,
    ParameterEntry,
    PartKind,
    PlantDocument,
    read_plant_document,
    write_plant_document,
)
from models.plant.provenance import Provenance
from models.plant.scope import Scope, variables_of, without_values
from models.plant.step_model import StepModel
from models.trials.trial import SignalRole

__all__ = ["LOADS", "NOMINAL", "ModelKind", "Plant", "read_plant"]

ModelKind = Literal["twin", "observer", "driven"]
LOADS: Final[dict[str, type[PlantLoad]]] = {
    load.kind: load for load in (Link, Pendulum, Mass, FlexibleLink, GearedShaft, GearedSlide)
}
"""Loads by their name in a plant document."""
COMPOSERS: Final = {
    "twin": compose_twin, "observer": compose_observer, "driven": compose_driven,
}  # fmt: skip
NOMINAL: Final = Path(__file__).with_name("nominal.toml")
"""The plant before anything is identified."""


@dataclass(frozen=True)
class Plant:
    """A plant: drive, load, effects and parameters.

    Attributes
    ----------
    name : str
        For people.
    drive, load : str
        Their kinds.
    effects : tuple of str
        Names of its effects.
    parameters : dict of str to Parameter
        All of them, for two joints where the load has two.
    expected : dict of str to Parameter
        Parameters of effects that the plant does not have yet, where its file gives them.
    signals : dict of str to SignalRole
        Columns of a trial where they are not the link's.
    provenance : Provenance
        Parent, data, fitted trials and held-out errors.
    """

    name: str
    drive: str
    load: str
    effects: tuple[str, ...]
    parameters: dict[str, Parameter]
    expected: dict[str, Parameter] = field(default_factory=dict)
    signals: dict[str, SignalRole] = field(default_factory=dict)
    provenance: Provenance = field(default_factory=Provenance)

    def step_model(self, dof: int, kind: ModelKind = "twin") -> StepModel:
        """Compose the plant for stepping.

        Parameters
        ----------
        dof : int
            Joints, 1 or 2.
        kind : {"twin", "observer", "driven"}
            Closed loop from goals; link driven by measured angles and currents; link driven by
            measured angles with its payload given.

        Returns
        -------
        StepModel
            Twin: inputs goal_j_rad, payload_kg; outputs angle_j_rad, current_j_a, di, tip_*_m.
            Observer: inputs angle_j_rad, current_j_a; outputs di, tip_*_m, payload_kg.
            Driven: inputs angle_j_rad, payload_kg; outputs current_j_a, di, tip_*_m.

        Raises
        ------
        InputError
            If the load does not have so many joints, or there is no such model of this plant.

        Examples
        --------
        >>> model = read_plant().step_model(dof=1)
        >>> [v.name for v in model.inputs]
        ['goal_1_rad', 'payload_kg']
        >>> [v.name for v in model.outputs]
        ['angle_1_rad', 'current_1_a', 'di', 'tip_x_m', 'tip_y_m', 'tip_z_m']
        """
        if not 1 <= dof <= LOADS[self.load].max_dof:
            raise InputError("dof", f"{dof} joints for load {self.load!r}", "choose another plant")
        if kind != "twin" and (self.load, self.drive) != ("link", "cascade"):
            raise InputError(
                f"plant {self.name!r}",
                f"there is no {kind} for a {self.load} on a {self.drive} drive",
                "use the twin",
            )  # fmt: skip
        effects = tuple(EFFECTS[name] for name in in_order(self.effects))
        known, columns = without_values(self.parameters), tuple(self.signals)
        model = _composed(self.load, self.drive, effects, known, dof, kind, columns)
        return replace(model, parameters=variables_of(self.parameters, model.parameters))

    def _effects(self) -> list[Effect]:
        return [EFFECTS[name]() for name in in_order(self.effects)]

    def with_values(
        self, values: Mapping[str, float], errors: Mapping[str, float] | None = None
    ) -> Plant:
        """Plant with some values changed.

        Parameters
        ----------
        values : mapping of str to float
            By name of the parameter, in its unit.
        errors : mapping of str to float, optional
            Standard errors, by name.

        Raises
        ------
        InputError
            If a name is unknown, or a value lies outside its bounds.
        """
        parameters = dict(self.parameters)
        for name, value in values.items():
            if name not in parameters:
                raise InputError(name, "is no parameter of the plant", "see the plant document")
            error = (errors or {}).get(name, parameters[name].error)
            parameters[name] = msgspec.structs.replace(
                parameters[name], value=float(value), error=None if error is None else float(error)
            )
        check_values(f"plant {self.name!r}", parameters.values())
        return replace(self, parameters=parameters)

    def with_effects(self, *names: str) -> Plant:
        """Plant that also has these effects, at the default strength of their class.

        Parameters
        ----------
        *names : str
            Of the catalogue, or of one's own effects.

        Raises
        ------
        InputError
            If an effect is unknown, or the drive and the load do not allow it.
        """
        effects = (*self.effects, *(n for n in names if n not in self.effects))
        return _complete(replace(self, effects=effects), "effects", {})

    def applicable(self) -> list[str]:
        """Names of the effects that this drive and this load allow."""
        return applicable(DRIVES[self.drive], LOADS[self.load])

    def strengths(self, effect: str, dof: int) -> tuple[str, ...]:
        """Names of an effect's strength parameter: one per joint, or one for all.

        Parameters
        ----------
        effect : str
            Name of the effect.
        dof : int
            Joints, 1 or 2.
        """
        return EFFECTS[effect].strengths(_scope(self.load, dof))

    def document(self) -> PlantDocument:
        """Content of the plant's file."""
        return PlantDocument(
            schema=PlantDocument.VERSION,
            name=self.name,
            drive=PartKind(self.drive),
            load=PartKind(self.load),
            effects=[EffectEntry(name) for name in self.effects],
            signals=self.signals,
            parameters={
                q.name: ParameterEntry(
                    q.value, q.unit, (q.low, q.high), q.role, q.source, q.error, q.prior_deviation
                )
                for q in (*self.parameters.values(), *self.expected.values())
            },
            provenance=self.provenance,
        )

    def sha256(self) -> str:
        """Hash of the document, for provenance."""
        plain = msgspec.to_builtins(self.document())
        return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()

    def write(self, path: Path | str) -> None:
        """Write the plant file; JSON or TOML by the suffix.

        Parameters
        ----------
        path : Path or str
            `.toml`, anything else is JSON.
        """
        write_plant_document(self.document(), Path(path))


def read_plant(path: Path | str = NOMINAL) -> Plant:
    """Read a plant file.

    Parameters
    ----------
    path : Path or str
        TOML or JSON; by default the plant before anything is identified.

    Raises
    ------
    InputError
        If the file is missing or no plant document, a kind, an effect, a parameter or a unit is
        unknown, or a value lies outside its bounds.

    Examples
    --------
    >>> plant = read_plant()
    >>> plant.drive, plant.load
    ('cascade', 'link')
    >>> q = plant.parameters["link_mass_kg"]
    >>> q.value, q.unit, (q.low, q.high)
    (0.9, 'kg', (0.5, 2.0))
    """
    path = Path(path)
    document = read_plant_document(path)
    for what, kind, known in (
        ("drive", document.drive.kind, DRIVES),
        ("load", document.load.kind, LOADS),
    ):
        if kind not in known:
            raise InputError(path, f"{kind!r} is no {what}", "choose from " + ", ".join(known))
    plant = Plant(
        name=document.name,
        drive=document.drive.kind,
        load=document.load.kind,
        effects=tuple(e.name for e in document.effects),
        parameters={},
        signals=document.signals,
        provenance=document.provenance,
    )
    return _complete(plant, path, document.parameters)


def _complete(
    plant: Plant, where: Path | str, entries: Mapping[str, float | ParameterEntry]
) -> Plant:
    """Plant with every parameter that its parts declare, replaced by the entries of a document.

    The entries may also be parameters of effects that the plant does not have yet.
    """
    check_effects(where, plant.effects, DRIVES[plant.drive], LOADS[plant.load])
    scope = _scope(plant.load, LOADS[plant.load].max_dof)
    parts = plant.drive, plant.load
    own = {q.name: q for q in _declared(scope, *parts, plant._effects(), observer=True)}
    others = [EFFECTS[name]() for name in plant.applicable()]
    possible = {q.name: q for q in _declared(scope, *parts, others, observer=True)}
    known = plant.expected | plant.parameters
    parameters = {name: known.get(name, q) for name, q in own.items()}
    expected = {name: q for name, q in known.items() if name not in own and name in possible}
    for name, given in entries.items():
        if name in possible and name not in parameters:
            expected[name] = _merge(where, possible[name], given)
            continue
        if name not in parameters:
            raise InputError(
                where, f"parameter {name!r} belongs to no part of this plant",
                "correct the name, or add the effect that it belongs to",
            )  # fmt: skip
        parameters[name] = _merge(where, parameters[name], given)
    check_values(str(where), (*parameters.values(), *expected.values()))
    return replace(plant, parameters=parameters, expected=expected)


def _merge(where: Path | str, q: Parameter, given: float | ParameterEntry) -> Parameter:
    entry = given if isinstance(given, ParameterEntry) else ParameterEntry(value=float(given))
    if entry.unit is not None and entry.unit != q.unit:
        raise InputError(
            where, f"parameter {q.name} is given in {entry.unit!r}", f"convert it to {q.unit!r}"
        )
    (low, high), spread = entry.bounds or (q.low, q.high), entry.prior_deviation or 0.0
    if not (math.isfinite(entry.value) and -math.inf < low <= high < math.inf > spread >= 0.0):
        raise InputError(where, f"parameter {q.name} is not a finite number", "correct it")
    return msgspec.structs.replace(
        q, value=float(entry.value), low=float(low), high=float(high), error=entry.error,
        role=entry.role or q.role, source=q.source if entry.source is None else entry.source,
        prior_deviation=entry.prior_deviation or q.prior_deviation,
    )  # fmt: skip


@lru_cache(maxsize=64)  # an observer of two joints takes three seconds to compose
def _composed(
    load: str, drive: str, effects: tuple[type[Effect], ...],
    parameters: tuple[tuple[str, Parameter], ...], dof: int, kind: ModelKind,
    columns: tuple[str, ...],
) -> StepModel:  # fmt: skip
    """Compose a plant from hashable parts; values are arguments, so plants share a model."""
    scope, held = _scope(load, dof, columns), [effect() for effect in effects]
    known, observer = dict(parameters), kind != "twin"
    scope.declare([known[q.name] for q in _declared(scope, drive, load, held, observer)])
    imposed = kind == "twin" and "imposed motion" in DRIVES[drive].features
    compose = compose_imposed if imposed else COMPOSERS[kind]
    return compose(f"{kind}_{dof}dof", scope, DRIVES[drive](), LOADS[load](), held)


def _scope(load: str, dof: int, columns: tuple[str, ...] = ()) -> Scope:
    return Scope(tuple(range(1, dof + 1)), dict(LOADS[load].suffix), columns)


def _declared(
    scope: Scope, drive: str, load: str, effects: list[Effect], observer: bool
) -> list[Parameter]:
    """Parameters of all parts, in order."""
    return [
        *DRIVES[drive]().parameters(scope),
        *LOADS[load]().parameters(scope),
        *(q for effect in effects for q in effect.parameters(scope)),
        *((FOLLOW_RATE, *observer_parameters()) if observer and load == "link" else ()),
    ]
