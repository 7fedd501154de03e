"""Interface of a kind of cases: the options of a case, and the function that runs one.

A kind is a module with a `CaseKind` named `KIND`. The campaign and every worker import the module,
so put slow imports into the function.
"""

from __future__ import annotations

import functools
import importlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Final, Generic, TypeVar

import msgspec
from msgspec import Meta

from firmware_py.core.errors import InputError
from firmware_py.core.motion import KINDS as MOTIONS
from firmware_py.core.motion import STUDY_AMPLITUDE_RAD, STUDY_PERIOD_S, MotionConfig
from hil.campaign.code_version import content_sha256
from models.shared.catalogue import CATALOGUE

KINDS: Final = {name: f"hil.campaign.kinds.{name}_kind" for name in ("sil", "fmu", "gap", "rig")}
"""Module of each kind that has a short name."""

Seed = Annotated[int, Meta(ge=0, lt=2**32)]
"""Seed of NumPy's generators."""


class CaseOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of the options of a case; a field without a default is required.

    `msgspec.Meta` limits the values of a field; `__post_init__` may raise `InputError` for what
    types do not say.
    """

    def files(self) -> dict[str, str]:
        """Return the fields that name files or directories.

        Returns
        -------
        dict of str to str
            Path by name of the field. The contents of the files are part of the case's key.
        """
        return {}

    @property
    def in_real_time(self) -> bool:
        """Whether the case measures timing, so that no other program may disturb it."""
        return False


class MotionOptions(CaseOptions, frozen=True, kw_only=True):
    """Options of a case that runs a motion."""

    motion: str = "sinusoid"  # Kind of motion, or a motion file
    amplitude_rad: float = STUDY_AMPLITUDE_RAD
    period_s: Annotated[float, Meta(ge=0.1, le=1e4)] = STUDY_PERIOD_S
    phase_2_rad: float = 0.0

    def files(self) -> dict[str, str]:
        return {} if self.motion in MOTIONS else {"motion": self.motion}

    def motion_config(self) -> MotionConfig:
        return MotionConfig(
            amplitude_rad=self.amplitude_rad, period_s=self.period_s, phase_2_rad=self.phase_2_rad
        ).with_motion(self.motion)


Options = TypeVar("Options", bound=CaseOptions)


@dataclass(frozen=True)
class CaseKind(Generic[Options]):
    """Kind of cases; make one to run your own cases in a campaign.

    Parameters
    ----------
    name : str
        Name of the kind.
    options : type
        Options of a case, a subclass of `CaseOptions`.
    run : callable
        `run(options, scratch)` runs a case and returns its result, a dictionary that JSON can hold.
        The result must depend on the options alone. `scratch` is a directory that is removed after
        the case. An `InputError` says that the case cannot be run; the campaign records it and
        continues.
    sources : tuple of str
        Folders of the sources that compute the result. Results count only for the version of this
        code that computed them.
    figures : mapping of str to str
        Numbers of the result that the page shows, by dotted name, with their labels. A name that
        ends in an SI unit is shown in the display unit of that quantity.
    prepare : callable, optional
        `prepare(options, directory)` makes files that many cases share, such as a twin, and returns
        options that name them. The campaign calls it for every case that it will run, so make a
        file only once.
    """

    name: str
    options: type[Options]
    run: Callable[[Options, Path], dict[str, Any]]
    sources: tuple[str, ...]
    figures: Mapping[str, str] = field(default_factory=dict)
    prepare: Callable[[Options, Path], Options] = lambda options, directory: options


def load_kind(name: str) -> tuple[CaseKind[Any], str]:
    """Import a kind by its short name, or by the name of a module with `KIND`; and the module."""
    module = KINDS.get(name, name)
    remedy = f"choose {', '.join(KINDS)}, or a module with KIND"
    if not all(part.isidentifier() for part in module.split(".")) or "." not in module:
        raise InputError(f"kind {name!r}", "is not known", remedy)
    try:
        kind = importlib.import_module(module).KIND
    except Exception as error:  # a module may raise anything during its import
        raise InputError(f"kind {name!r}", f"cannot be imported ({error})", remedy) from None
    if not isinstance(kind, CaseKind):
        raise InputError(f"kind {name!r}", "has a KIND that is no CaseKind", remedy)
    return kind, module


def check_effects(effects: Iterable[str]) -> None:
    """Refuse an effect that is not in the catalogue."""
    if unknown := sorted(set(effects) - set(CATALOGUE)):
        remedy = "choose from " + ", ".join(CATALOGUE)
        raise InputError(f"effects.{unknown[0]}", "is no effect", remedy)


def load_once(load: Callable[[Path], Any], path: Path) -> Any:
    """Load a file or directory of the cases once per worker, and again when its content changes."""
    return _load(load, path, content_sha256(path))


@functools.lru_cache(maxsize=8)
def _load(load: Callable[[Path], Any], path: Path, sha256: str) -> Any:
    return load(path)
