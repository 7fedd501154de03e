"""Plant: drive, load, effects and parameters, composed into step models.

Read a plant file with `read_plant` and write one with `Plant.write`; its form is
`models.plant.document`. `Plant.step_model` composes it (`models.plant.compose`).
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

import msgspec
import numpy as np

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import read_toml
from firmware_py.core.signals import PERIOD_S
from firmware_py.link.link_description import STUDY_LINK, LinkDescription, describes_link, read_link
from firmware_py.link.link_facts import LinkFacts, facts_of_plant
from models.plant.components import DRIVES, LOADS
from models.plant.compose import FOLLOW_RATE, compose_driven, compose_twin
from models.plant.document import (
    EffectEntry,
    ParameterEntry,
    PartKind,
    PlantDocument,
    Provenance,
    check_condition_units,
    merged_parameter,
    plain_plant,
    read_plant_document,
    write_plant_document,
)
from models.plant.effects import EFFECTS, Effect, applicable, check_effects, in_order
from models.plant.observer import OBSERVER_PARAMETERS, compose_observer
from models.plant.parameter import Parameter, check_payload, check_values, parameter_of_link
from models.plant.scope import Scope, variable_of, without_values
from models.plant.step_model import StepModel
from models.shared.link_scale import LinkScale
from models.trials.trial import SignalRole

if TYPE_CHECKING:
    import control

NOMINAL: Final = Path(__file__).with_name("nominal.toml")
"""The plant before anything is identified."""

ModelKind = Literal["twin", "observer", "driven"]

MOST_ANGLE_RAD: Final = math.radians(90.0)
"""Largest angle at which a twin is linearised: beyond a right angle the arm leans back over its
mount [assumed]."""


@dataclass(frozen=True, repr=False)
class Plant:
    """Model of the machine: drive, load, effects and parameters.

    Attributes
    ----------
    name : str
        Name for display.
    drive, load : str
        Kinds of the drive and the load.
    effects : tuple of str
        Names of the effects that it has.
    parameters : dict of str to Parameter
        Every parameter by name, for both joints where the load has two.
    expected : dict of str to Parameter
        Parameters from the file that belong to effects which the plant does not have yet.
    signals : dict of str to SignalRole
        Columns of a trial for a plant that is not the link.
    provenance : Provenance
        Parent plant, data, fitted trials and held-out errors.
    link : LinkDescription or None
        Described link that the plant models (markers, gravity, servo); None for the study's.
    path : Path
        File that it was read from; empty for a plant that was not read from a file.

    Examples
    --------
    >>> plant = read_plant()
    >>> plant
    <Plant 'drop-stitch link, nominal': cascade drive, link, 7 effects, 74 parameters>
    >>> heavier = plant.with_values({"link_mass_kg": 1.1}).with_effects("backlash")
    >>> heavier.effects[-2:]
    ('prebend', 'backlash')
    """

    name: str
    drive: str
    load: str
    effects: tuple[str, ...]
    parameters: dict[str, Parameter]
    expected: dict[str, Parameter] = field(default_factory=dict)
    signals: dict[str, SignalRole] = field(default_factory=dict)
    provenance: Provenance = field(default_factory=Provenance)
    link: LinkDescription | None = None
    path: Path = field(default=Path(), compare=False)

    def __repr__(self) -> str:
        effects = f"{len(self.effects)} effect{'' if len(self.effects) == 1 else 's'}"
        return (
            f"<Plant {self.name!r}: {self.drive} drive, {self.load}, {effects}, "
            f"{len(self.parameters)} parameters>"
        )

    def _repr_html_(self) -> str:
        from models.shared.notebook import html_table

        free = [q for q in self.parameters.values() if q.role != "fixed"]
        rows = [
            (q.name, f"{q.value:.4g}", "" if q.error is None else f"{q.error:.2g}", q.unit,
             q.description)
            for q in free
        ]  # fmt: skip
        head = ("parameter to identify", "value", "standard error", "unit", "meaning")
        return html_table(repr(self)[1:-1], head, rows)

    def linearise(
        self,
        payload_kg: float | None = None,
        *,
        dof: int = 1,
        period_s: float = PERIOD_S,
        angles_rad: Sequence[float] | None = None,
        sliding: bool = True,
    ) -> control.StateSpace:
        """Linearise the twin about rest, with exact derivatives of one control period.

        Parameters
        ----------
        payload_kg : float, optional
            Mass at the tip; by default half of the link's largest.
        dof : int
            Number of joints, 1 or 2.
        period_s : float
            Control period.
        angles_rad : sequence of float, optional
            Goals at which the arm rests, one per joint; by default zero.
        sliding : bool
            Whether dry friction is left out, as while the joints move. At rest it is as stiff as
            its smoothing.

        Returns
        -------
        control.StateSpace
            Sampled system from the goals to the outputs of the twin, with named signals.

        Raises
        ------
        InputError
            If the plant is not the link or cannot carry the payload, or an argument is out of
            range.

        Examples
        --------
        >>> system = read_plant().linearise(payload_kg=1.0)
        >>> system.dt, system.input_labels
        (0.017, ['goal_1_rad'])
        """
        from models.plant.linear_twin import LinearTwins  # loads python-control

        if self.load != "link":
            raise InputError(f"plant {self.name!r}", "is not the link", "name a plant of the link")
        if payload_kg is None:
            payload_kg = (self.link or STUDY_LINK).payload_kg / 2
        check_payload(payload_kg, link=self.link)
        if not 1e-3 <= period_s <= 1.0:
            raise InputError("period", f"is {period_s:g} s", "give 0.001 to 1 s")
        angles = np.zeros(dof) if angles_rad is None else np.asarray(angles_rad, dtype=np.float64)
        degrees = np.rad2deg(angles).round(6).tolist()
        if angles.shape != (dof,):
            raise InputError("angles", f"are {degrees}°", f"give {dof}, one per joint")
        if not (np.abs(angles) <= MOST_ANGLE_RAD).all():
            limit = f"{math.degrees(MOST_ANGLE_RAD):g}° at most"
            raise InputError("angles", f"are {degrees}°", f"give {limit}")
        return LinearTwins(self.step_model(dof), period_s).at(payload_kg, angles, sliding=sliding)

    def step_model(
        self, dof: int, kind: ModelKind = "twin", *, with_age: bool = False
    ) -> StepModel:
        """Compose the plant for stepping.

        Parameters
        ----------
        dof : int
            Number of joints, 1 or 2.
        kind : {"twin", "observer", "driven"}
            `twin`: closed loop, driven by goals. `observer`: link driven by measured angles and
            currents. `driven`: link driven by measured angles, with a known payload.
        with_age : bool
            Whether the observer has the age of the sample, age_s, as its last input, which a
            predictor beside it needs.

        Returns
        -------
        StepModel
            Twin: inputs goal_j_rad, payload_kg; outputs angle_j_rad, current_j_a, di, tip_*_m.
            Observer: inputs angle_j_rad, current_j_a; outputs di, tip_*_m, payload_kg.
            Driven: inputs angle_j_rad, payload_kg; outputs current_j_a, di, tip_*_m.

        Raises
        ------
        InputError
            If the load has fewer joints, or this plant has no model of that kind.

        Examples
        --------
        >>> [v.name for v in read_plant().step_model(dof=1).inputs]
        ['goal_1_rad', 'payload_kg']
        """
        if not 1 <= dof <= LOADS[self.load].max_dof:
            raise InputError("dof", f"{dof} joints for load {self.load!r}", "choose another plant")
        if kind != "twin" and (self.load, self.drive) != ("link", "cascade"):
            raise InputError(
                f"plant {self.name!r}",
                f"there is no {kind} for a {self.load} on a {self.drive} drive",
                "use the twin",
            )  # fmt: skip
        model = _compose(
            self.drive, self.load, _classes(self.effects), without_values(self.parameters), dof,
            kind, tuple(self.signals), self.link, with_age=with_age,
        )  # fmt: skip
        values = tuple(variable_of(self.parameters[v.name]) for v in model.parameters)
        model = replace(model, parameters=values)
        return model.with_substeps(model.max_substep_s) if kind == "observer" else model

    def with_values(
        self, values: Mapping[str, float], errors: Mapping[str, float] | None = None
    ) -> Plant:
        """Return the plant with some values changed.

        Parameters
        ----------
        values : mapping of str to float
            New values by parameter name, each in the parameter's unit.
        errors : mapping of str to float, optional
            Standard errors by parameter name; the others keep theirs.

        Raises
        ------
        InputError
            If a name is unknown, or a value lies outside its bounds.

        Examples
        --------
        >>> read_plant().with_values({"link_mass_kg": 1.1}).parameters["link_mass_kg"].value
        1.1
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
        """Return the plant with these effects added, at the default strength of their class.

        Parameters
        ----------
        *names : str
            Effects of the catalogue, or registered by you.

        Raises
        ------
        InputError
            If an effect is unknown, or the drive and the load do not allow it.
        """
        effects = (*self.effects, *(n for n in names if n not in self.effects))
        return _complete(replace(self, effects=effects), "effects", {})

    def applicable(self) -> list[str]:
        """Return the names of the effects that drive and load allow."""
        return applicable(DRIVES[self.drive], LOADS[self.load])

    def strengths(self, effect: str, dof: int) -> tuple[str, ...]:
        """Return the names of an effect's strength: one per joint, or one for all."""
        return EFFECTS[effect].strengths(scope_of(self.drive, self.load, dof))

    @property
    def where(self) -> str:
        """File or name of the plant, for messages."""
        return str(self.path) if self.path.name else f"plant {self.name!r}"

    def link_facts(self) -> LinkFacts:
        """Return the facts that identify the plant's link; fails for a plant of another machine."""
        facts = facts_of_plant(plain_plant(self.document()))
        if facts is None:
            raise InputError(f"plant {self.name!r}", "is no link", "use a plant of a link")
        return facts

    def document(self) -> PlantDocument:
        """Return the content of the plant's file."""
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
            link=self.link,
        )

    def for_robot(self) -> Plant:
        """Return the plant as a bundle stores it: without the noise floor of the gap workflow."""
        provenance = msgspec.structs.replace(self.provenance, noise_floor={})
        return replace(self, provenance=provenance)

    def sha256(self) -> str:
        """Return the hash of the document, for provenance."""
        plain = plain_plant(self.document())
        return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()

    def write(self, path: Path | str) -> None:
        """Write the plant file: JSON for the suffix `.json`, otherwise TOML."""
        write_plant_document(self.document(), Path(path))


def read_plant(path: Path | str = NOMINAL) -> Plant:
    """Read a plant file.

    Parameters
    ----------
    path : Path or str
        TOML or JSON; by default the nominal plant, before identification. A link file
        (`firmware_py.link.link_description`) gives the nominal plant scaled to that link.

    Raises
    ------
    InputError
        If the file is missing or no plant document; if a kind, effect, parameter or unit is
        unknown; if a value lies outside its bounds; or if a constant of the machine is missing.

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
    if path.suffix.lower() == ".toml" and describes_link(read_toml(path, "name a plant or a link")):
        return _plant_of_link(read_link(path), path)
    document = read_plant_document(path)
    drive, load = document.drive.kind, document.load.kind
    for what, kind, known in (("drive", drive, DRIVES), ("load", load, LOADS)):
        if kind not in known:
            raise InputError(path, f"{kind!r} is no {what}", "choose from " + ", ".join(known))
    effects = tuple(e.name for e in document.effects)
    plant = Plant(
        document.name, drive, load, effects, {}, signals=document.signals,
        provenance=document.provenance, link=document.link, path=path,
    )  # fmt: skip
    return _complete(plant, path, document.parameters)


def _plant_of_link(link: LinkDescription, where: Path) -> Plant:
    """Nominal plant of a described link: the study's, with values, bounds and priors scaled."""
    nominal, scale = read_plant(), LinkScale(link)
    known = _declared(nominal, nominal.applicable()) | nominal.expected | nominal.parameters
    scaled = {name: parameter_of_link(q, scale) for name, q in known.items()}
    plant = replace(nominal, name=f"{link.name}, nominal", link=link, parameters=scaled, path=where)
    return _complete(plant, where, {})


def _complete(
    plant: Plant, where: Path | str, entries: Mapping[str, float | ParameterEntry]
) -> Plant:
    """Plant with every parameter that its parts declare, updated by the entries of a file.

    An entry may also set a parameter of an effect that the plant does not have yet.
    """
    check_effects(where, plant.effects, DRIVES[plant.drive], LOADS[plant.load])
    known = plant.expected | plant.parameters
    full = {
        name: msgspec.structs.replace(known.get(name, q), description=q.description)
        for name, q in _declared(plant, plant.applicable()).items()
    }
    for name, entry in entries.items():
        if name not in full:
            raise InputError(
                where, f"parameter {name!r} belongs to no part of this plant",
                "correct the name, or add the effect that it belongs to",
            )  # fmt: skip
        full[name] = merged_parameter(where, full[name], entry)
    parameters = {name: full[name] for name in _declared(plant, plant.effects)}
    set_too = (known.keys() | entries.keys()) - parameters.keys()
    expected = {name: q for name, q in full.items() if name in set_too}
    check_values(str(where), (*parameters.values(), *expected.values()))
    check_condition_units(Path(where), plant.signals, parameters)
    return replace(plant, parameters=parameters, expected=expected)


def _declared(plant: Plant, effects: Iterable[str]) -> dict[str, Parameter]:
    """Parameters that the parts of a plant declare with these effects, by name."""
    scope = scope_of(plant.drive, plant.load, LOADS[plant.load].max_dof, link=plant.link)
    declared = declared_parameters(scope, plant.drive, plant.load, _classes(effects), observer=True)
    return {q.name: q for q in declared}


def _classes(names: Iterable[str]) -> tuple[type[Effect], ...]:
    return tuple(EFFECTS[name] for name in in_order(names))


@lru_cache(maxsize=64)  # composing an observer of two joints takes three seconds
def _compose(
    drive: str, load: str, effects: tuple[type[Effect], ...],
    parameters: tuple[tuple[str, Parameter], ...], dof: int, kind: ModelKind,
    columns: tuple[str, ...], link: LinkDescription | None, *, with_age: bool,
) -> StepModel:  # fmt: skip
    """Compose a plant from hashable parts; values are arguments, so plants share a model."""
    scope, known = scope_of(drive, load, dof, columns, link), dict(parameters)
    declared = declared_parameters(scope, drive, load, effects, observer=kind != "twin")
    scope.declare([known[q.name] for q in declared])
    compose: Callable[..., StepModel]
    if kind == "observer":
        compose = partial(compose_observer, with_age=with_age)
    elif kind == "driven" or "imposed motion" in DRIVES[drive].features:
        compose = compose_driven
    else:
        compose = compose_twin
    parts = DRIVES[drive](), LOADS[load](), [effect() for effect in effects]
    return compose(f"{kind}_{dof}dof", scope, *parts)


def scope_of(
    drive: str,
    load: str,
    dof: int,
    columns: tuple[str, ...] = (),
    link: LinkDescription | None = None,
) -> Scope:
    """Scope of a drive and a load, before anything is declared.

    `link` sets markers, direction of gravity and largest payload; by default the study's.
    """
    machine = link or STUDY_LINK
    return Scope(
        joints=tuple(range(1, dof + 1)),
        suffix=dict(LOADS[load].suffix),
        columns=columns,
        layout=None if link is None else link.layout,
        gravity=machine.gravity.unit,
        most_payload_kg=machine.most_payload_kg,
        features=frozenset(DRIVES[drive].features) | frozenset(LOADS[load].features),
    )


def declared_parameters(
    scope: Scope, drive: str, load: str, effects: Iterable[type[Effect]], observer: bool
) -> list[Parameter]:
    """Parameters of drive, load, effects and observer, in that order."""
    return [
        *DRIVES[drive]().parameters(scope),
        *LOADS[load]().parameters(scope),
        *(q for effect in effects for q in effect().parameters(scope)),
        *((FOLLOW_RATE, *OBSERVER_PARAMETERS) if observer and load == "link" else ()),
    ]
