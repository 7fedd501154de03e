"""The plant document: drive, load, effects and parameters, read, checked, written, composed.

People write TOML, `identify` writes JSON of the same form::

    schema = 1
    name = "drop-stitch link"
    drive = { kind = "cascade" }        # models.plant.components.drives.DRIVES
    load = { kind = "link" }            # models.plant.plant.LOADS
    effects = [{ name = "coulomb_friction" }, …]
    [signals.angle_1_rad]               # only where they are not those of the link
    unit = "rad"
    role = "measured"
    [parameters.link_mass_kg]           # or just  link_mass_kg = 0.9  under [parameters]
    value = 0.9
    unit = "kg"
    bounds = [0.3, 3.0]
    source = "weighed"
"""

from __future__ import annotations

import hashlib
import json
import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar, Final, Literal

import msgspec
import tomli_w

from firmware_py.documents import Document
from firmware_py.errors import InputError
from models.plant.components.drives import DRIVES
from models.plant.components.link import Link
from models.plant.components.load_protocol import PlantLoad
from models.plant.components.rigid_loads import Mass, Pendulum
from models.plant.composition.driven_link import FOLLOW_RATE, compose_driven
from models.plant.composition.observer import compose_observer, observer_parameters
from models.plant.composition.twin import compose_twin
from models.plant.effects import EFFECTS, Effect, applicable, check_effects
from models.plant.effects.order import in_order
from models.plant.parameter import Parameter, Role, check_values
from models.plant.provenance import Provenance, read_provenance
from models.plant.scope import Scope
from models.plant.step_model import StepModel
from models.trials.trial import SignalRole

Unit = Literal["twin", "observer", "driven"]
LOADS: Final[dict[str, type[PlantLoad]]] = {load.kind: load for load in (Link, Pendulum, Mass)}
"""Loads by the name that a plant document gives them."""
COMPOSERS: Final = {
    "twin": compose_twin, "observer": compose_observer, "driven": compose_driven,
}  # fmt: skip
NOMINAL: Final = Path(__file__).with_name("nominal.toml")
"""The plant before anything is identified."""


class PartKind(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Drive or load of a plant document, by its kind."""

    kind: str


class EffectEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Effect of a plant document, by its name in the catalogue."""

    name: str


class ParameterEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Parameter of a plant document; a key that is left out keeps the default of its part."""

    value: float
    unit: str | None = None
    bounds: tuple[float, float] | None = None
    role: Role | None = None
    source: str | None = None
    error: float | None = None


class PlantDocument(Document, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A plant file, TOML or JSON; see the module's text."""

    MADE_BY: ClassVar[str] = "python -m models identify"

    name: str
    drive: PartKind
    load: PartKind
    effects: list[EffectEntry] = msgspec.field(default_factory=list)
    signals: dict[str, SignalRole] = msgspec.field(default_factory=dict)
    parameters: dict[str, float | ParameterEntry] = msgspec.field(default_factory=dict)
    provenance: Provenance = msgspec.field(default_factory=Provenance)


@dataclass(frozen=True)
class Plant:
    """A plant: what it is made of and what its parameters are.

    Attributes
    ----------
    name : str
        For people.
    drive, load : str
        Their kinds.
    effects : tuple of str
        Names of the effects that it holds.
    parameters : dict of str to Parameter
        All of them, for two joints where the load has two.
    expected : dict of str to Parameter
        What is known of effects that the plant does not hold (yet).
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

    def step_model(self, dof: int, unit: Unit = "twin") -> StepModel:
        """Compose the plant for stepping.

        Parameters
        ----------
        dof : int
            Joints, 1 or 2.
        unit : {"twin", "observer", "driven"}
            Closed loop from goals; the link driven by measured angles and currents; the link
            driven by measured angles with its payload given.

        Returns
        -------
        StepModel
            Twin: inputs goal_j_rad, payload_kg; outputs angle_j_rad, current_j_a, di, tip_*_m.
            Observer: inputs angle_j_rad, current_j_a; outputs di, tip_*_m, payload_kg.
            Driven: inputs angle_j_rad, payload_kg; outputs current_j_a, di, tip_*_m.
        """
        if not 1 <= dof <= LOADS[self.load].max_dof:
            raise InputError("dof", f"{dof} joints for load {self.load!r}", "choose another plant")
        if unit != "twin" and (self.load, self.drive) != ("link", "cascade"):
            raise InputError(
                f"plant {self.name!r}",
                f"there is no {unit} unit for a {self.load} on a {self.drive} drive",
                "use the twin",
            )  # fmt: skip
        kinds = tuple(EFFECTS[name] for name in in_order(self.effects))
        return _composed(self.load, self.drive, kinds, tuple(self.parameters.items()), dof, unit)

    def _effects(self) -> list[Effect]:
        return [EFFECTS[name]() for name in in_order(self.effects)]

    def with_values(
        self, values: Mapping[str, float], errors: Mapping[str, float] | None = None
    ) -> Plant:
        """Plant with some values changed, checked against the bounds."""
        parameters = dict(self.parameters)
        for name, value in values.items():
            if name not in parameters:
                raise InputError(name, "is no parameter of the plant", "see the plant document")
            error = (errors or {}).get(name, parameters[name].error)
            parameters[name] = msgspec.structs.replace(
                parameters[name], value=float(value), error=error
            )
        check_values(f"plant {self.name!r}", parameters.values())
        return replace(self, parameters=parameters)

    def with_effects(self, *names: str) -> Plant:
        """Plant that also holds these effects, at the strength that their class gives."""
        effects = (*self.effects, *(n for n in names if n not in self.effects))
        return _complete(replace(self, effects=effects), "effects", {})

    def applicable(self) -> list[str]:
        """Names of the effects that this drive and this load can hold."""
        return applicable(DRIVES[self.drive], LOADS[self.load])

    def strengths(self, effect: str, dof: int) -> tuple[str, ...]:
        """Names of an effect's strength: one per joint, or one for all."""
        return EFFECTS[effect].strengths(_scope(self.load, dof))

    def document(self) -> dict[str, Any]:
        """Content of the plant's file, in plain types."""
        document = PlantDocument(
            schema=PlantDocument.VERSION,
            name=self.name,
            drive=PartKind(self.drive),
            load=PartKind(self.load),
            effects=[EffectEntry(name) for name in self.effects],
            signals=self.signals,
            parameters={
                q.name: ParameterEntry(q.value, q.unit, (q.low, q.high), q.role, q.source, q.error)
                for q in (*self.parameters.values(), *self.expected.values())
            },
            provenance=self.provenance,
        )
        plain: dict[str, Any] = msgspec.to_builtins(document)
        return plain

    def sha256(self) -> str:
        """Hash of the document, for provenance."""
        return hashlib.sha256(json.dumps(self.document(), sort_keys=True).encode()).hexdigest()

    def write(self, path: Path | str) -> None:
        """Write the document; JSON or TOML by the suffix."""
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        text = (
            tomli_w.dumps(_without_none(self.document()))
            if path.suffix == ".toml"
            else json.dumps(self.document(), indent=1) + "\n"
        )
        path.write_text(text, encoding="utf-8")


def read_plant(path: Path | str = NOMINAL) -> Plant:
    """Read a plant document (TOML or JSON).

    Raises
    ------
    InputError
        If the file is missing or no document, a kind, an effect, a parameter or a unit is
        unknown, or a value lies outside its bounds.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
        raw = json.loads(text) if path.suffix == ".json" else tomllib.loads(text)
        table = raw.pop("provenance", {}) if isinstance(raw, dict) else {}
        document = msgspec.convert(raw, PlantDocument)
    except OSError:
        raise InputError(
            path, "cannot be read", "name a plant, e.g. models/plant/nominal.toml"
        ) from None
    except (ValueError, msgspec.ValidationError) as error:
        raise InputError(path, f"is no plant document ({error})", "correct it") from None
    if document.schema != PlantDocument.VERSION:
        raise InputError(
            path, f"schema is {document.schema}", f"this version reads {PlantDocument.VERSION}"
        )
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
        provenance=read_provenance(path, table),
    )
    return _complete(plant, path, document.parameters)


def _complete(
    plant: Plant, where: Path | str, entries: Mapping[str, float | ParameterEntry]
) -> Plant:
    """Plant with every parameter that its parts declare, the document's put over theirs.

    A document may also say what it knows of effects that the plant could hold.
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


def _without_none(value: Any) -> Any:
    """Plain document without its empty entries, which TOML has no form for."""
    if isinstance(value, dict):
        return {k: _without_none(v) for k, v in value.items() if v is not None}
    return [_without_none(v) for v in value] if isinstance(value, list | tuple) else value


def _merge(where: Path | str, q: Parameter, given: float | ParameterEntry) -> Parameter:
    entry = given if isinstance(given, ParameterEntry) else ParameterEntry(value=float(given))
    if entry.unit is not None and entry.unit != q.unit:
        raise InputError(
            where, f"parameter {q.name} is given in {entry.unit!r}", f"convert it to {q.unit!r}"
        )
    low, high = entry.bounds or (q.low, q.high)
    if not (math.isfinite(entry.value) and low <= high):
        raise InputError(where, f"parameter {q.name} is not a finite number", "correct it")
    return msgspec.structs.replace(
        q, value=float(entry.value), low=float(low), high=float(high), error=entry.error,
        role=entry.role or q.role, source=q.source if entry.source is None else entry.source,
    )  # fmt: skip


@lru_cache(maxsize=16)  # an observer of two joints takes three seconds to compose
def _composed(
    load: str, drive: str, effects: tuple[type[Effect], ...],
    parameters: tuple[tuple[str, Parameter], ...], dof: int, unit: Unit,
) -> StepModel:  # fmt: skip
    """Compose a plant from hashable parts; a `StepModel` is immutable, so it can be shared."""
    scope, held = _scope(load, dof), [effect() for effect in effects]
    declared = _declared(scope, drive, load, held, observer=unit != "twin")
    known = dict(parameters)
    scope.declare([known[q.name] for q in declared])
    return COMPOSERS[unit](f"{unit}_{dof}dof", scope, DRIVES[drive](), LOADS[load](), held)


def _scope(load: str, dof: int) -> Scope:
    return Scope(tuple(range(1, dof + 1)), suffix=dict(LOADS[load].suffix))


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
