"""Table of claims (`docs/claims.toml`) and the figures accepted for them (`docs/claims.json`)."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any, ClassVar, Final

import msgspec

from firmware_py.documents import Document, read_document
from firmware_py.errors import InputError

ROOT: Final = Path(__file__).parents[2]
TABLE: Final = ROOT / "docs" / "claims.toml"
ACCEPTED: Final = ROOT / "docs" / "claims.json"


class Claim(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One figure: where it is stated, how it is measured, what it should be."""

    name: str  # Name of the claim, and the table that it stands in
    group: str
    what: str
    stated_in: list[str]  # Files that state the figure; each holds the group's table
    # Shell command that measures it, run in the checkout. Claims with the same command share a run.
    command: str
    value: str  # JSON pointer (RFC 6901) to the number
    # JSON file that the command leaves; without one, its standard output is read. "time" gives
    # `/seconds`, the command's duration.
    result: str = ""
    over: str = ""  # JSON pointer to a number by which it is divided; none if empty
    interval: str = ""  # JSON pointers to a 95 % interval and to the number of cases; none if empty
    of: str = ""
    factor: float = 1.0  # Number in the result to the number in `unit`
    unit: str = ""  # Unit in which the figure is stated; empty for a plain number
    digits: int = 2  # Decimals that are stated
    # Target in `unit`. Without one the figure is stated and not judged.
    at_most: float | None = None
    at_least: float | None = None
    equal_to: float | None = None  # Target and the largest distance from it
    within: float | None = None
    headline: bool = False  # Whether the figure also stands in the table of the README
    minutes: float = 1.0  # Expected duration of the command on two cores

    def is_met(self, value: float) -> bool | None:
        """Whether a value in `unit` meets the target; None without a target."""
        if self.at_most is not None:
            return value <= self.at_most
        if self.at_least is not None:
            return value >= self.at_least
        if self.equal_to is not None:
            return abs(value - self.equal_to) <= (self.within or 0.0)
        return None

    @property
    def target(self) -> str:
        """The target in words; empty without one."""
        if self.at_most is not None:
            return f"≤ {self.at_most:g}{self._suffix}"
        if self.at_least is not None:
            return f"≥ {self.at_least:g}{self._suffix}"
        if self.equal_to is not None:
            return f"{self.equal_to:g} ± {self.within or 0:g}{self._suffix}"
        return ""

    def shown(self, figure: ClaimFigure) -> str:
        """A figure as a table states it."""
        text = f"{figure.value:.{self.digits}f}{self._suffix}"
        if figure.interval:
            text += f" ({figure.interval[0]:.{self.digits}f}–{figure.interval[1]:.{self.digits}f})"
        return text + (f" of {figure.of}" if figure.of is not None else "")

    @property
    def _suffix(self) -> str:
        return f" {self.unit}" if self.unit else ""


class ClaimFigure(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A value that was reached."""

    value: float  # In the claim's unit
    interval: tuple[float, ...] = ()
    of: int | None = None
    on: str = ""  # Date of the measurement, ISO 8601
    # What a reader has to know; "recorded" where the value was taken over from the documentation
    # and its command has not been run since
    note: str = ""


class AcceptedFigures(Document, frozen=True, kw_only=True):
    """The last accepted figure of every claim: `docs/claims.json`."""

    MADE_BY: ClassVar[str] = "make claims-accept"

    figures: dict[str, ClaimFigure]


class _Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    claim: list[Claim]
    titles: dict[str, str] = {}


def read_claims(path: Path = TABLE) -> list[Claim]:
    """All claims, in the order of the table."""
    return list(_read(path).claim)


def read_titles(path: Path = TABLE) -> dict[str, str]:
    """Title of each group."""
    return dict(_read(path).titles)


def _read(path: Path) -> _Table:
    remedy = "see bench/claims/claim_table.py for its fields"
    try:
        raw: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
        table = msgspec.convert(raw, _Table)
    except (OSError, tomllib.TOMLDecodeError, msgspec.ValidationError) as error:
        raise InputError(path, f"is no table of claims ({error})", remedy) from error
    names = [c.name for c in table.claim]
    for claim in table.claim:
        targets = [t for t in (claim.at_most, claim.at_least, claim.equal_to) if t is not None]
        if names.count(claim.name) > 1:
            raise InputError(path, f"names {claim.name} twice", "give every claim its own name")
        if len(targets) > 1:
            raise InputError(path, f"{claim.name} has two targets", "state one")
        if claim.group not in table.titles:
            raise InputError(path, f"group {claim.group} has no title", "add it to [titles]")
    return table


def read_accepted(path: Path = ACCEPTED) -> dict[str, ClaimFigure]:
    """The accepted figure of each claim; empty where the file does not exist."""
    return dict(read_document(path, AcceptedFigures).figures) if path.exists() else {}
