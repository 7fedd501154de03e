"""Interface of a kind of cases: a configuration, its files, and the function that runs it.

A kind is a module with an instance of `CaseKind` named `KIND`. The module is imported by the
campaign and by every worker: what is slow to import belongs into `run`.
"""

from __future__ import annotations

import importlib
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Final, Generic, TypeVar

import msgspec

from firmware_py.errors import InputError

C = TypeVar("C", bound=msgspec.Struct)

KINDS: Final = {
    "sil": "hil.campaign.kinds.sil_kind",
    "fmu": "hil.campaign.kinds.fmu_kind",
    "gap": "hil.campaign.kinds.gap_kind",
    "rig": "hil.campaign.kinds.rig_kind",
}
"""Module of each kind that a campaign names by one word."""


class CaseConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of every configuration: every field has a default or is required."""


@dataclass
class CaseContext:
    """Surroundings of a running case."""

    scratch: Path  # Directory that is removed after the case
    # Durations that the case measures; they are kept beside the result, not in it
    parts_s: dict[str, float] = field(default_factory=dict)


class CaseKind(ABC, Generic[C]):
    """Kind of cases.

    Attributes
    ----------
    name : str
        Word for it.
    config : type
        Struct of its configuration.
    rooms : tuple of str
        Rooms whose code computes the result.
    figures : mapping of str to str
        Numbers of the result that a page shows, each with its words; a name that ends in an SI
        unit is shown in the display unit of that.
    """

    name: ClassVar[str]
    config: ClassVar[type[Any]]
    rooms: ClassVar[tuple[str, ...]]
    figures: ClassVar[Mapping[str, str]] = {}

    def files(self, config: C) -> dict[str, str]:
        """Fields of a configuration that name files or directories, with their paths.

        Parameters
        ----------
        config : CaseConfig
            Of a case.
        """
        return {}

    def check(self, config: C) -> None:
        """Refuse a configuration that its types do not refuse; called for every case.

        Parameters
        ----------
        config : CaseConfig
            Of a case.

        Raises
        ------
        InputError
            If it cannot be run.
        """

    def in_real_time(self, config: C) -> bool:
        """Whether the case measures time, so that it needs a machine of its own.

        Parameters
        ----------
        config : CaseConfig
            Of a case.
        """
        return False

    def prepare(self, config: C, directory: Path) -> dict[str, str]:
        """Make what many cases share; return fields to set, with their paths.

        Called by the campaign for cases that are to be run, often with equal configurations.

        Parameters
        ----------
        config : CaseConfig
            Of a case.
        directory : Path
            Of what is shared.
        """
        return {}

    @abstractmethod
    def run(self, config: C, context: CaseContext) -> dict[str, Any]:
        """Run a case; return its result, which depends on nothing but the configuration.

        Parameters
        ----------
        config : CaseConfig
            Of the case.
        context : CaseContext
            Directory and durations.

        Raises
        ------
        InputError
            If the case cannot be run; the campaign keeps the sentence and goes on.
        """


def kind_module(name: str) -> str:
    """Module of a kind by its word, or the name of a module itself."""
    return KINDS.get(name, name)


def load_kind(module: str) -> CaseKind[Any]:
    """Kind of a module.

    `module`: word of a kind, or dotted name of a module with `KIND`.
    """
    name = kind_module(module)
    remedy = f"choose {', '.join(KINDS)}, or a module with KIND"
    if not all(part.isidentifier() for part in name.split(".")) or "." not in name:
        raise InputError(f"kind {name!r}", "is not known", remedy)
    try:
        kind = importlib.import_module(name).KIND
    except Exception as error:  # whatever a module raises while it is imported
        raise InputError(f"kind {name!r}", f"cannot be imported ({error})", remedy) from None
    if not isinstance(kind, CaseKind):
        raise InputError(f"kind {name!r}", "has a KIND that is no CaseKind", remedy)
    return kind
