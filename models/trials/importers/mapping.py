"""MAP.toml: what a recording cannot say about itself.

::

    step_s = 0.017                     # uniform step of the trial
    plant = "xl330_pendulum.toml"      # beside the map, with the [signals] of a plant not the link

    [trial]                            # the trial's conditions (docs/architecture.md)
    dof = 1                            # schema, source, rest_samples and period_s may be left out
    payload_kg = 1.0
    motion = { from = "trajectory" }   # what stands once in the file, by its name there
    …

    [conditions]                       # what the plant's file calls a condition: a number, or
    duty_gain_1 = { from = "kp", unit = "1", scale = 0.00287736 }   # as a column's

    [columns]                          # table, C3D analog: contract name = where it comes from
    time_s      = { from = "stamp", unit = "ms" }
    angle_1_rad = { from = "Present Position", unit = "deg" }
    current_1_a = { from = "cur", unit = "mA", scale = -1.0, offset = 0.0 }

    [servo_columns]                    # the same for --servo, where it is another table

    [markers]                          # motive, C3D, rosbag: contract name = name in the file
    m01 = "Link:Marker 001"
    tip = "EndEffector"

    [topics]                           # rosbag: topic = joints | goals | markers | tip | m01 …
    "/joint_states" = "joints"

    [frame]                            # mocap frame -> world frame
    up = "y"                           # axis of the file that points up
    align = "rest"                     # fit the rest pose to the upright link, or "none"
    origin_m = [0.0, 0.0, 0.0]         # crossing of the joint axes, after the turn to z-up
    yaw_deg = 0.0                      # turn about z that takes the file's x to the world's x
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any, Literal

import msgspec

from firmware_py.errors import InputError
from firmware_py.signals import PERIOD_S
from models.trials.importers.series import factor_to_si
from models.trials.trial import SignalRole, TrialMeta
from models.trials.trial_files import check_meta

MARKERS = tuple(f"m{i:02d}" for i in range(1, 17))


class Column(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One `[columns]` entry: SI value = raw value x scale x (unit to SI) + offset."""

    source: str = msgspec.field(name="from")
    unit: str | None = None
    scale: float = 1.0
    offset: float = 0.0


class Frame(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How the frame of the motion capture lies in the world; see the module's text."""

    up: Literal["x", "y", "z"] | None = None
    align: Literal["rest", "none"] = "none"
    origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw_deg: float = 0.0


class Mapping(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A decoded MAP.toml; see the module's text."""

    trial: dict[str, Any] = {}
    conditions: dict[str, float | Column] = {}
    plant: str = ""
    signals: dict[str, SignalRole] = {}
    step_s: float = PERIOD_S
    columns: dict[str, Column] = {}
    servo_columns: dict[str, Column] = {}
    markers: dict[str, str] = {}
    topics: dict[str, str] = {}
    joints: list[str] = []
    effort_unit: str = "A"
    frame: Frame = Frame()
    path: str = "--map"

    def meta(self, rest_samples: int, duration_s: float | None = None) -> TrialMeta:
        """Conditions of the trial; `rest_samples` and the period where the map leaves them out."""
        document = {"source": "measured", "rest_samples": rest_samples} | self.trial
        if self.signals and duration_s is not None:
            document = {"period_s": duration_s} | document
        if self.conditions:
            document["conditions"] = self.conditions
        return check_meta(document, Path(self.path), self.signals)

    def with_facts(self, facts: dict[str, Any], where: Path) -> Mapping:
        """The mapping with what it takes `from` the file once, put in place.

        Parameters
        ----------
        facts : dict
            What stands once in the file, by name.
        where : Path
            The file.
        """
        trial = {
            key: self._fact(facts, where, key, entry["from"]) if isinstance(entry, dict) else entry
            for key, entry in self.trial.items()
        }
        conditions: dict[str, float | Column] = {}
        for key, entry in self.conditions.items():
            if isinstance(entry, Column):
                raw = self._fact(facts, where, key, entry.source)
                if not isinstance(raw, int | float):
                    raise InputError(where, f"{entry.source} is {raw!r}, no number", "correct it")
                factor = entry.scale * factor_to_si(Path(self.path), key, entry.unit or "1")
                conditions[key] = float(raw) * factor + entry.offset
            else:
                conditions[key] = entry
        return msgspec.structs.replace(self, trial=trial, conditions=conditions)

    def _fact(self, facts: dict[str, Any], where: Path, key: str, name: Any) -> Any:
        if name not in facts:
            raise InputError(
                where, f"{name!r}, which {self.path} takes {key} from, does not stand in it",
                "write the value itself into the map",
            )  # fmt: skip
        return facts[name]

    def for_servo(self) -> Mapping:
        """The mapping under which the file of `--servo` is read."""
        return msgspec.structs.replace(self, columns=self.servo_columns or self.columns)

    @property
    def dof(self) -> int:
        """Joints of the trial, 1 or 2."""
        dof = self.trial.get("dof")
        if dof not in (1, 2):
            raise InputError(self.path, f"[trial] dof is {dof!r}", "set dof = 1 or dof = 2")
        return int(dof)

    def marker_of(self, name: str) -> str | None:
        """Contract name (`m01` …, `tip`) of a marker that the file calls `name`, else None."""
        for ours, theirs in self.markers.items():
            if name == theirs:
                return ours
        bare = name.rsplit(":", 1)[-1].strip().lower()
        return bare if not self.markers and bare in (*MARKERS, "tip") else None


def read_mapping(path: Path | None) -> Mapping:
    """Read MAP.toml; without one the file must carry the contract's names and units.

    Raises
    ------
    InputError
        If the file is missing or is not TOML, or a key or value is wrong.
    """
    if path is None:
        return Mapping()
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
        mapping = msgspec.convert(document, Mapping)
    except FileNotFoundError:
        raise InputError(path, "is missing", "name an existing MAP.toml") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(path, f"is not TOML ({error})", "correct the line it names") from None
    except msgspec.ValidationError as error:
        raise InputError(path, str(error), "see docs/trials.md for its form") from None
    for name in mapping.markers:
        if name not in (*MARKERS, "tip"):
            raise InputError(path, f"[markers] {name!r} is no marker", "use m01 … m16 or tip")
    if not mapping.step_s > 0:
        raise InputError(path, f"step_s is {mapping.step_s}", f"give one above 0, like {PERIOD_S}")
    mapping = msgspec.structs.replace(mapping, path=str(path))
    if mapping.plant:
        mapping = msgspec.structs.replace(mapping, signals=_signals(path.parent / mapping.plant))
    return mapping


def _signals(path: Path) -> dict[str, SignalRole]:
    """Signals that a plant's file declares, without composing the plant."""
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
        return msgspec.convert(document.get("signals", {}), dict[str, SignalRole])
    except OSError:
        raise InputError(path, "cannot be read", "correct 'plant' in the map") from None
    except (ValueError, msgspec.ValidationError) as error:
        raise InputError(path, f"is no plant document ({error})", "correct it") from None
