"""What a rig is: the structure of its equations, and the values that belong to it.

Both are read from TOML files, with unit and source of each value. The rig of a described link has
the study's values, scaled by size, section, pressure and servo.
"""

from __future__ import annotations

import hashlib
import math
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Final, Literal, NamedTuple

import msgspec

from firmware_py.bus.servo_models import model_named
from firmware_py.core.errors import InputError
from firmware_py.core.input_files import convert, read_toml
from firmware_py.link.link_description import STUDY_LINK, LinkDescription
from firmware_py.link.marker_layout import MarkerLayout, square_layout
from models.shared.catalogue import effect_and_joint
from models.shared.link_scale import LinkScale
from models.trials.units import exponents_in

RIG_TOML: Final = Path(__file__).with_name("rig.toml")
STRUCTURES: Final = Path(__file__).with_name("structures")
"""Files of the named structures, `NAME.toml`."""


class RigStructure(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Forms of a rig's equations (docs/rig/structures.md); the defaults are the project's rig."""

    # Mechanics of the link: hinges in MuJoCo, or a Cosserat rod
    engine: Literal["mujoco", "cosserat"] = "mujoco"
    # The link with hinges (`models.rig.hinged`): hinge pairs of the span, how the moment levels
    # off at its limit, friction of the skin, spectrum of relaxation times
    hinges: Annotated[int, msgspec.Meta(ge=5, le=17)] = 8
    limit: Literal["tanh", "wrinkling"] = "tanh"
    hysteresis: Literal["bouc_wen", "maxwell_slip", "dahl"] = "bouc_wen"
    creep: Literal["branches", "power_law"] = "branches"
    # The servo (`models.rig.servo`): friction, and how its Stribeck part fades with the rate
    friction: Literal["lugre", "smooth"] = "lugre"
    stribeck: Literal["gaussian", "rational"] = "gaussian"
    # Where the backlash is: in the gear, or in the link's mount (`models.rig.rig.MarkerPlay`)
    play: Literal["gear", "markers"] = "gear"
    # The servo again: set-point between two goals, current in its register, position loop, rate
    goal: Literal["held", "interpolated", "profile"] = "held"
    current_sampling: Literal["tick", "phase", "mean"] = "tick"
    position_loop: Literal["proportional", "feedforward"] = "proportional"
    rate_sensor: Literal["motor", "encoder"] = "motor"
    # Filter in the software of the motion capture (`models.rig.sensors`)
    mocap_filter: Literal["none", "low_pass", "zero_phase"] = "none"


DEFAULT_STRUCTURE: Final = RigStructure()


class NamedStructure(msgspec.Struct, frozen=True, kw_only=True):
    """Content of a structure's file, apart from parameters."""

    summary: str
    # "tuning" if numbers of the workflow may be set on it, "test" if they never are
    purpose: Literal["tuning", "test"]
    structure: RigStructure


def named_structures() -> dict[str, NamedStructure]:
    """Named structures by name, the default first."""
    paths = sorted(STRUCTURES.glob("*.toml"), key=lambda p: (p.stem != "default", p.stem))
    return {p.stem: _structure_of(tomllib.loads(p.read_text(encoding="utf-8")), p) for p in paths}


def _structure_of(document: dict[str, Any], path: Path) -> NamedStructure:
    remedy = "see docs/rig/structures.md for its form"
    return convert(document, NamedStructure, path, "is no structure of a rig", remedy)


class Entry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One parameter, as a table of the TOML file."""

    value: float
    unit: str  # SI unit; "1" if dimensionless
    source: str  # Where the value comes from
    effect: str = ""  # Effect of the catalogue that adds its strength to the value; empty for none
    in_one_joint: bool = False  # Whether the effect may be hidden in a single joint
    minimum: float = -math.inf  # Lower bound of the value, with all strengths added
    maximum: float = math.inf


@dataclass(frozen=True, repr=False)
class RigParameters(Mapping[str, float]):
    """Parameters of a rig: values by name, like `parameters["servo.coulomb_friction_nm"]`.

    Attributes
    ----------
    entries : dict of str to Entry
        Value, unit, source and bounds by `group.name`.
    path : Path
        File that the parameters were read from.
    structure : RigStructure
        Forms of the equations that the values belong to.
    link : LinkDescription or None
        Link that the values were scaled to; None for the study's.
    added_in_joint : dict of int to dict of str to float
        Additions to values of a single joint, by joint and parameter name.

    Examples
    --------
    >>> import dropstitch
    >>> rig = dropstitch.rig_named("default")
    >>> rig.hide({"dead_time": 0.03}).changed(**{"world.pause_s": 1.0})["world.pause_s"]
    1.0
    """

    entries: dict[str, Entry]
    path: Path
    structure: RigStructure = DEFAULT_STRUCTURE
    link: LinkDescription | None = None
    added_in_joint: Mapping[int, Mapping[str, float]] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"<RigParameters of {self.path.name}: {len(self.entries)} values>"

    def __getitem__(self, name: str) -> float:
        return self.entries[name].value

    def __iter__(self) -> Iterator[str]:
        return iter(self.entries)

    def __len__(self) -> int:
        return len(self.entries)

    @property
    def layout(self) -> MarkerLayout:
        """Layout of the markers on the link."""
        if self.link is not None:
            return self.link.layout
        return square_layout(self["link.length_m"], self["link.width_m"])

    def changed(self, **values: float) -> RigParameters:
        """Return the parameters with other values, by `group.name`."""
        changed = {n: msgspec.structs.replace(self.entries[n], value=v) for n, v in values.items()}
        return replace(self, entries=self.entries | changed)

    def scaled(self, names: Sequence[str], factor: float) -> RigParameters:
        """Return the parameters with some values multiplied, also additions in a single joint."""
        added = {
            joint: {n: more * (factor if n in names else 1.0) for n, more in additions.items()}
            for joint, additions in self.added_in_joint.items()
        }
        scaled = self.changed(**{name: self[name] * factor for name in names})
        return replace(scaled, added_in_joint=added)

    def of_joint(self, joint: int) -> RigParameters:
        """Return the parameters of one joint, 1 or 2, with what is added in it."""
        added = self.added_in_joint.get(joint, {})
        return self.changed(**{name: self[name] + more for name, more in added.items()})

    def sha256(self) -> str:
        """Return the hash of structure, values and described link, for provenance."""
        content: list[Any] = [self.structure, dict(self), *([self.link] if self.link else [])]
        content += [self.added_in_joint] if self.added_in_joint else []
        return hashlib.sha256(msgspec.json.encode(content)).hexdigest()

    def effects(self) -> dict[str, str]:
        """Return the effects that this rig can hide, each with its parameter's name."""
        return {entry.effect: name for name, entry in self.entries.items() if entry.effect}

    def hide(self, strengths: Mapping[str, float]) -> RigParameters:
        """Return the rig with effects of the catalogue added to its defaults.

        Parameters
        ----------
        strengths : mapping of str to float
            Strength by EFFECT, or by EFFECT:JOINT for a single joint, in the effect's unit in
            `models.shared.catalogue`.

        Raises
        ------
        InputError
            If the rig lacks an effect, cannot hide it in a single joint, or the sum leaves the
            parameter's bounds.
        """
        result, names = self, self.effects()
        for hidden, strength in sorted(strengths.items(), key=lambda item: ":" in item[0]):
            option = f"--hide {hidden}={strength:g}"
            effect, joint = effect_and_joint(hidden)
            if effect not in names:
                choice = "choose from " + ", ".join(names)
                raise InputError(option, "has no place in this rig", choice)
            name = names[effect]
            entry = result.entries[name]
            if joint is not None and not entry.in_one_joint:
                raise InputError(
                    option, f"{effect} is not of one joint alone", "leave the joint out"
                )
            value, low, high = entry.value + strength, entry.minimum, entry.maximum
            if not low <= value <= high:
                raise InputError(
                    option, f"makes {name} {value:g} {entry.unit}, outside {low:g} to {high:g}",
                    f"choose {low - entry.value:g} to {high - entry.value:g}",
                )  # fmt: skip
            if joint is None:
                result = result.changed(**{name: value})
            else:
                added = {**result.added_in_joint.get(joint, {}), name: strength}
                result = replace(result, added_in_joint={**result.added_in_joint, joint: added})
        return result


def read_parameters(path: Path = RIG_TOML) -> RigParameters:
    """Read the parameters of a rig: a file changes values and structure of the project's rig.

    Effects and bounds remain those of `rig.toml`.
    """
    entries = dict(_entries(read_toml(RIG_TOML, "restore it"), RIG_TOML))
    if path == RIG_TOML:
        return RigParameters(entries, path)
    names = ", ".join(named_structures())
    document = read_toml(path, f"name a structure ({names}) or the TOML file of a rig")
    structured = "structure" in document
    structure = _structure_of(document, path).structure if structured else DEFAULT_STRUCTURE
    for name, change in _entries(document, path):
        if name not in entries:
            raise InputError(path, f"parameter {name} is unknown", f"see {RIG_TOML} for names")
        entry = entries[name]
        if change.unit != entry.unit:
            raise InputError(path, f"{name} is in {change.unit!r}", f"give it in {entry.unit}")
        if change.effect not in ("", entry.effect):
            raise InputError(
                path, f"{name} is not the parameter of {change.effect!r}", "leave effect out"
            )
        if not (math.isfinite(change.value) and entry.minimum <= change.value <= entry.maximum):
            raise InputError(path, f"{name} is {change.value}", "keep it within its bounds")
        changed = msgspec.structs.replace(entry, value=change.value, source=change.source)
        entries[name] = changed
    return RigParameters(entries, path, structure)


def _entries(document: dict[str, Any], path: Path) -> Iterator[tuple[str, Entry]]:
    for group, tables in document.items():
        if isinstance(tables, dict) and group != "structure":
            for key, table in tables.items():
                name = f"{group}.{key}"
                yield name, convert(table, Entry, path, name, "give value, unit and source")


class LinkStiffness(NamedTuple):
    """Stiffness and limit moments of the link at its pressure."""

    bending_n_m2: float
    root_nm_rad: float
    shear_n: float
    root_limit_nm: float
    span_limit_nm: float


def link_stiffness(parameters: RigParameters) -> LinkStiffness:
    """Stiffness and limit moments of a rig, whose values belong to the reference pressure.

    Pressure enters the tension of the walls, which adds to EI and so to the root patch, the shear
    stiffness and the limit moments, as in `models.shared.link_scale`.
    """
    p = parameters
    section, reference = (
        LinkScale(msgspec.structs.replace(
            p.link or STUDY_LINK, width_m=p["link.width_m"], pressure_pa=p[f"stiffness.{name}"]
        ))
        for name in ("pressure_pa", "reference_pressure_pa")
    )  # fmt: skip
    tension_n_m = section.tension_n_m - reference.tension_n_m
    bending_n_m2 = p["stiffness.bending_n_m2"] + section.second_moment_m3 * tension_n_m
    pressure = p["stiffness.pressure_pa"] / p["stiffness.reference_pressure_pa"]
    return LinkStiffness(
        bending_n_m2,
        p["stiffness.root_nm_rad"] * bending_n_m2 / p["stiffness.bending_n_m2"],
        p["stiffness.wall_shear_n"] + p["stiffness.pressure_pa"] * section.area_m2,
        pressure * p["stiffness.root_limit_nm"],
        pressure * p["stiffness.span_limit_nm"],
    )


def rig_of_link(link: LinkDescription, path: Path) -> RigParameters:
    """Rig of a described link: the study's values, scaled by size, section, pressure and servo."""
    rig = read_parameters()
    model, preset = model_named(link.servo.model), link.preset
    scale = LinkScale(link)
    servo, over = scale.servo_ratios, scale.over_study
    # The rig brings its values from the reference pressure to the link's.
    reference_pa = rig["stiffness.reference_pressure_pa"]
    over_at_reference = LinkScale(
        msgspec.structs.replace(link, pressure_pa=reference_pa)
    ).over_study
    width = link.width_m / STUDY_LINK.width_m
    length = link.length_m / STUDY_LINK.length_m
    inertia, coulomb = servo["rotor_inertia_kg_m2"], servo["coulomb_friction_nm"]
    # What depends on more than the servo's torque and current, which follow from the unit
    ratios = {
        "link.mass_kg": over("mass_kg"),
        "link.tip_mass_kg": over("tip_mass_kg"),
        "link.payload_size_m": width,
        "link.plate_mass_kg": over("plate_m2"),
        "link.yoke_mass_kg": servo["mass_kg"],
        "link.frame_inertia_kg_m2": over("plate_m2") ** 2,
        "stiffness.bending_n_m2": over_at_reference("bending_n_m2"),
        "stiffness.wall_shear_n": over("wall_shear_n"),
        "stiffness.root_nm_rad": over_at_reference("root_nm_rad"),
        "stiffness.root_limit_nm": over_at_reference("limit_moment_nm"),
        "stiffness.span_limit_nm": over_at_reference("limit_moment_nm"),
        "stiffness.damping_s": 1 / over("first_mode_rad_s"),
        "servo.speed_limit_rad_s": servo["speed_limit_rad_s"],
        "servo.inertia_kg_m2": inertia,
        "servo.torque_constant_nm_a": servo["torque_constant_nm_a"],
        "servo.coulomb_friction_nm": coulomb,
        "servo.viscous_friction_nm_s_rad": servo["viscous_friction_nm_s_rad"],
        "servo.stribeck_friction_nm": coulomb,
        "servo.load_friction_share": servo["load_friction"],
        "servo.breakaway_friction_nm": coulomb,
        # Presliding over the same angle, with the same damping ratio against the rotor.
        "servo.bristle_stiffness_nm_rad": coulomb,
        "servo.bristle_damping_nm_s_rad": math.sqrt(coulomb * inertia),
        "servo.backlash_rad": servo["backlash_rad"],
        # The rotor swings on the gear at the same frequency.
        "servo.gear_compliance_rad_nm": 1 / inertia,
        "servo.gear_damping_nm_s_rad": inertia,
        "variation.eccentricity_m": width,
        "world.drag_nm": width * length**4,
    }
    entries = {}
    for name, entry in rig.entries.items():
        ratio = ratios.get(name)
        if ratio is None:
            ratio = scale.ratio_of_unit(exponents_in(f"{rig.path}, {name}", entry.unit))
        entries[name] = msgspec.structs.replace(
            entry, value=entry.value * ratio,
            minimum=entry.minimum * ratio, maximum=entry.maximum * ratio,
        )  # fmt: skip
    return replace(rig, entries=entries, path=path, link=link).changed(**{
        "link.length_m": link.length_m,
        "link.width_m": link.width_m,
        "link.base_offset_m": link.base_offset_m,
        "stiffness.pressure_pa": link.pressure_pa,
        "servo.profile_velocity_rad_s": min(
            rig["servo.profile_velocity_rad_s"], preset.speed_limit_rad_s
        ),
        "sensor.pulses_per_turn": float(model.pulses_per_turn),
        "sensor.current_step_a": model.current_a_per_lsb,
        "world.gravity_m_s2": link.gravity.size_m_s2,
    })  # fmt: skip
