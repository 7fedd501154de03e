"""Interface of a kind of cases: a configuration, its files, and the function that runs it.

A kind is a module with an instance of `CaseKind` named `KIND`. The campaign and every worker import
the module, so put slow imports into `run`.
"""

from __future__ import annotations

import importlib
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Final, Generic, TypeVar

import msgspec

from firmware_py.core.errors import InputError

C = TypeVar("C", bound=msgspec.Struct)

KINDS: Final = {
    "sil": "hil.campaign.kinds.sil_kind",
    "fmu": "hil.campaign.kinds.fmu_kind",
    "gap": "hil.campaign.kinds.gap_kind",
    "rig": "hil.campaign.kinds.rig_kind",
}
"""Module of each kind that has a short name."""


class CaseConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of the configurations; a field without a default is required."""


@dataclass
class CaseContext:
    """Scratch directory and measured durations of a running case."""

    scratch: Path  # Directory that is removed after the case
    # Durations that the case measures, in s; they are stored with the costs, not in the result
    parts_s: dict[str, float] = field(default_factory=dict)


class CaseKind(ABC, Generic[C]):
    """Kind of cases; derive from it to run your own cases in a campaign.

    Attributes
    ----------
    name : str
        Name of the kind.
    config : type
        Configuration of a case, a subclass of `CaseConfig`.
    rooms : tuple of str
        Folders of the sources that compute the result. Results count only for the version of this
        code that computed them.
    figures : mapping of str to str
        Numbers of the result that the page shows, by dotted name, with their labels. A name that
        ends in an SI unit is shown in the display unit of that quantity.
    """

    name: ClassVar[str]
    config: ClassVar[type[Any]]
    rooms: ClassVar[tuple[str, ...]]
    figures: ClassVar[Mapping[str, str]] = {}

    def files(self, config: C) -> dict[str, str]:
        """Return the fields of a configuration that name files or directories.

        Parameters
        ----------
        config : CaseConfig
            Configuration of a case.

        Returns
        -------
        dict of str to str
            Path by name of the field.
        """
        return {}

    def check(self, config: C) -> None:
        """Check what the types of a configuration do not; called for every case.

        Parameters
        ----------
        config : CaseConfig
            Configuration of a case.

        Raises
        ------
        InputError
            If the case cannot be run.
        """

    def in_real_time(self, config: C) -> bool:
        """Return whether the case measures timing, so that no other program may disturb it.

        Parameters
        ----------
        config : CaseConfig
            Configuration of a case.

        Returns
        -------
        bool
            By default False.
        """
        return False

    def prepare(self, config: C, directory: Path) -> dict[str, str]:
        """Make files that many cases share, such as a twin.

        The campaign calls this for every case that it will run, so make a file only once.

        Parameters
        ----------
        config : CaseConfig
            Configuration of a case.
        directory : Path
            Directory for the shared files.

        Returns
        -------
        dict of str to str
            Fields to set in the configuration, with their paths.
        """
        return {}

    @abstractmethod
    def run(self, config: C, context: CaseContext) -> dict[str, Any]:
        """Run a case.

        Parameters
        ----------
        config : CaseConfig
            Configuration of the case.
        context : CaseContext
            Scratch directory, and durations to fill in.

        Returns
        -------
        dict of str to Any
            Result, which must depend only on the configuration; values that JSON can hold.

        Raises
        ------
        InputError
            If the case cannot be run. The campaign records the message and continues.
        """


def kind_module(name: str) -> str:
    """Return the module of a kind: by its short name, or the name itself."""
    return KINDS.get(name, name)


def load_kind(module: str) -> CaseKind[Any]:
    """Import a kind by its short name, or by the dotted name of a module with `KIND`."""
    name = kind_module(module)
    remedy = f"choose {', '.join(KINDS)}, or a module with KIND"
    if not all(part.isidentifier() for part in name.split(".")) or "." not in name:
        raise InputError(f"kind {name!r}", "is not known", remedy)
    try:
        kind = importlib.import_module(name).KIND
    except Exception as error:  # a module may raise anything during its import
        raise InputError(f"kind {name!r}", f"cannot be imported ({error})", remedy) from None
    if not isinstance(kind, CaseKind):
        raise InputError(f"kind {name!r}", "has a KIND that is no CaseKind", remedy)
    return kind
