"""Specification of a campaign: kind, fixed values, grid and draw, and the values of each case.

Tables may be nested: `[grid.effects]` with `backlash = [0, 0.006]` is an axis `effects.backlash`.
Draw k depends only on the campaign's seed, on k and on the number of its grid combination, so a
campaign with more draws contains the cases of one with fewer.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import convert, read_toml

MOST_CASES: Final = 1_000_000
"""Largest number of cases: their keys alone take 300 MB [assumed]."""
DISTRIBUTIONS: Final = ("uniform", "log_uniform", "integers", "choice")


class CampaignSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Contents of the file; `read_spec` replaces the tables of axes by axes by dotted name."""

    kind: str  # sil, fmu, gap, rig, or a module with your own kind
    name: str = ""  # Heading of the page
    fixed: dict[str, Any] = {}  # Values common to all cases
    # Axes whose combinations are the cases: a list of values each, or `{first, count}`
    grid: dict[str, Any] = {}
    # Random axes: `{uniform = [a, b]}`, `{log_uniform = [a, b]}`, `{integers = [a, b]}` (including
    # both ends), `{choice = […]}`; after reading, a `Draw` each
    draw: dict[str, Any] = {}
    draws: Annotated[int, Meta(ge=1)] | None = None  # For each combination of the grid
    draw_seed: Annotated[int, Meta(ge=0)] = 0

    @property
    def axes(self) -> list[str]:
        """Names of the axes, those of the grid first."""
        return [*self.grid, *self.draw]


class Draw(NamedTuple):
    """Random axis."""

    form: str  # One of `DISTRIBUTIONS`
    limits: list[Any]  # Two limits, or the choices

    def value(self, rng: np.random.Generator) -> Any:
        if self.form == "choice":
            return self.limits[int(rng.integers(len(self.limits)))]
        low, high = self.limits
        if self.form == "integers":
            return int(rng.integers(low, high, endpoint=True))
        if self.form == "log_uniform":
            return float(np.exp(rng.uniform(math.log(low), math.log(high))))
        return float(rng.uniform(low, high))


def read_spec(path: Path) -> CampaignSpec:
    remedy = "see docs/campaigns.md"
    raw = convert(
        read_toml(path, f"write one, {remedy}"), CampaignSpec, path, "is no campaign", remedy
    )
    try:
        grid = {name: _grid_axis(name, v) for name, v in _leaves(raw.grid, _is_range)}
        draw = {name: _draw_axis(name, v) for name, v in _leaves(raw.draw, _is_distribution)}
    except ValueError as error:
        raise InputError(path, str(error), remedy) from None
    spec = msgspec.structs.replace(raw, grid=grid, draw=draw)
    _check_places(spec, path)
    if draw and spec.draws is None:
        raise InputError(path, "has a table [draw] but no number of draws", "add draws = 100")
    if spec.draws is not None and not draw:
        wrong = f"has draws = {spec.draws} without a table [draw]"
        raise InputError(path, wrong, "say what to draw")
    if math.prod(map(len, grid.values())) * (spec.draws or 1) > MOST_CASES:
        raise InputError(path, f"makes more than {MOST_CASES} cases", "divide the campaign")
    return spec


def configurations(spec: CampaignSpec) -> Iterator[dict[str, Any]]:
    """Yield the values of each case; draws change fastest, then the grid's last axis."""
    for number, values in enumerate(itertools.product(*spec.grid.values())):
        chosen = dict(zip(spec.grid, values, strict=True))
        for k in range(spec.draws or 1):
            rng = np.random.default_rng([spec.draw_seed, number, k])
            drawn = {name: spec.draw[name].value(rng) for name in sorted(spec.draw)}
            yield _nested(spec.fixed, chosen | drawn)


def _leaves(
    table: Mapping[str, Any], is_axis: Callable[[dict[str, Any]], bool], prefix: str = ""
) -> Iterator[tuple[str, Any]]:
    """Yield the values of nested tables by dotted name; a table that is an axis is a value."""
    for name, value in table.items():
        if isinstance(value, dict) and value and not is_axis(value):
            yield from _leaves(value, is_axis, f"{prefix}{name}.")
        else:
            yield prefix + name, value


def _is_range(table: dict[str, Any]) -> bool:
    return set(table) == {"first", "count"}


def _is_distribution(table: dict[str, Any]) -> bool:
    return len(table) == 1 and next(iter(table)) in DISTRIBUTIONS


def _grid_axis(name: str, value: Any) -> list[Any]:
    if isinstance(value, dict):
        first, count = value.get("first"), value.get("count")
        if type(first) is not int or type(count) is not int or count < 1:
            raise ValueError(f"axis {name} of [grid] needs whole numbers first and count ≥ 1")
        if count > MOST_CASES or first > 2**63 - count:
            raise ValueError(f"axis {name} of [grid] has too large a first or count")
        return list(range(first, first + count))
    if not isinstance(value, list):
        raise ValueError(f"axis {name} of [grid] is no list; one value belongs into [fixed]")
    if not value:
        raise ValueError(f"axis {name} of [grid] is empty, so that there is no case")
    return value


def _draw_axis(name: str, value: Any) -> Draw:
    if not isinstance(value, dict) or not _is_distribution(value):
        raise ValueError(f"axis {name} of [draw] needs one of {', '.join(DISTRIBUTIONS)}")
    ((form, limits),) = value.items()
    if not isinstance(limits, list) or not limits:
        raise ValueError(f"axis {name} of [draw] has nothing to draw from")
    if form != "choice":
        types, words = ((int,), "whole ") if form == "integers" else ((int, float), "")
        if len(limits) != 2 or not all(type(v) in types for v in limits):
            raise ValueError(f"axis {name} of [draw] needs two {words}numbers")
        low, high = limits
        if not low < high or (form == "log_uniform" and low <= 0):
            positive = ", the lower one positive" if form == "log_uniform" else ""
            raise ValueError(f"axis {name} of [draw] needs two rising limits{positive}")
        if not math.isfinite(high - low):
            raise ValueError(f"axis {name} of [draw] has limits too far apart")
    return Draw(form, limits)


def _check_places(spec: CampaignSpec, path: Path) -> None:
    """Refuse two places that set the same value, or one a table and the other a value inside."""
    fixed = [name for name, _ in _leaves(spec.fixed, lambda table: False)]
    tables = {"fixed": fixed, "grid": spec.grid, "draw": spec.draw}
    places = sorted((name.split("."), table) for table, names in tables.items() for name in names)
    # A name sorts directly before the names inside it.
    for (outer, table), (inner, other) in itertools.pairwise(places):
        if inner[: len(outer)] == outer:
            clash = f"{'.'.join(outer)} of [{table}] and {'.'.join(inner)} of [{other}]"
            raise InputError(path, f"{clash} set the same value", "keep one of them")


def _nested(fixed: Mapping[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """Insert the values of the axes into a copy of the fixed values."""
    result = {n: dict(v) if isinstance(v, dict) else v for n, v in fixed.items()}
    for name, value in values.items():
        *parents, last = name.split(".")
        place = result
        for parent in parents:
            place[parent] = dict(place.get(parent, {}))
            place = place[parent]
        place[last] = value
    return result
