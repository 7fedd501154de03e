"""File of a campaign: kind, fixed values, grid and draw, and the configurations that follow.

Names of the tables may be nested: `[grid.effects]` with `backlash = [0, 0.006]` is an axis
`effects.backlash`. Draw k of a campaign depends on its seed and on k alone, so that a campaign with
more draws holds the cases of one with fewer.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from firmware_py.errors import InputError
from firmware_py.files.input_files import convert, read_toml

MOST_CASES: Final = 1_000_000
"""Cases of the largest campaign: their keys alone take 300 MB [assumed]."""
MOST_WHOLE: Final = 2**63 - 1
"""Largest whole number of an axis: what a seed and NumPy's draws can be."""
DISTRIBUTIONS: Final = ("uniform", "log_uniform", "integers", "choice")
_COUNT: Final = {"first", "count"}

Axes = dict[str, Any]


class CampaignSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Content of the file."""

    kind: str  # sil, fmu, gap, rig, or a module with a kind of one's own
    name: str = ""  # Heading of the page
    fixed: dict[str, Any] = {}  # Values that all cases share
    # Axes of which every combination is a case: a list of values, or `{first, count}`
    grid: dict[str, Any] = {}
    # Axes that are drawn at random: `{uniform = [a, b]}`, `{log_uniform = [a, b]}`, `{integers =
    # [a, b]}` (both ends included), `{choice = […]}`
    draw: dict[str, Any] = {}
    draws: int | None = None  # Draws of each combination of the grid
    draw_seed: int = 0


def read_spec(path: Path) -> CampaignSpec:
    """Read the file of a campaign."""
    spec = convert(
        read_toml(path, "write one, see docs/campaigns.md"), CampaignSpec, path,
        "is no campaign", "see docs/campaigns.md",
    )  # fmt: skip
    return check_spec(spec, path)


def check_spec(spec: CampaignSpec, path: Path) -> CampaignSpec:
    """Return a campaign whose axes can be used."""
    try:
        grid, draw = grid_axes(spec.grid), draw_axes(spec.draw)
    except ValueError as error:
        raise InputError(path, str(error), "see docs/campaigns.md") from None
    places = [("fixed", name) for name in _fixed_names(spec.fixed)]
    places += [("grid", name) for name in grid] + [("draw", name) for name in draw]
    if clash := _clash(places):
        raise InputError(path, f"{clash} set the same value", "keep one of them")
    if draw and spec.draws is None:
        raise InputError(path, "has a table [draw] but no number of draws", "add draws = 100")
    if spec.draws is not None and (spec.draws < 1 or not draw):
        wrong = f"draws = {spec.draws}" + ("" if draw else " without a table [draw]")
        raise InputError(path, f"has {wrong}", "give 1 or more, and what to draw")
    if spec.draw_seed < 0:
        raise InputError(path, f"has draw_seed = {spec.draw_seed}", "give 0 or more")
    if case_count(spec) > MOST_CASES:
        raise InputError(path, f"makes more than {MOST_CASES} cases", "divide the campaign")
    return spec


def _fixed_names(table: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    """Dotted names of the fixed values; a list is one value, since an axis cannot be inside it."""
    for name, value in table.items():
        if isinstance(value, dict):
            yield from _fixed_names(value, f"{prefix}{name}.")
        else:
            yield prefix + name


def _clash(places: Sequence[tuple[str, str]]) -> str:
    """Two places of which one is the other or inside it, in words; empty where there are none."""
    tables: dict[str, str] = {}
    for table, name in places:
        if name in tables:
            return f"{name} of [{tables[name]}] and {name} of [{table}]"
        tables[name] = table
    for name, table in tables.items():
        parts = name.split(".")
        for k in range(1, len(parts)):
            if (outer := ".".join(parts[:k])) in tables:
                return f"{outer} of [{tables[outer]}] and {name} of [{table}]"
    return ""


def case_count(spec: CampaignSpec) -> int:
    """Number of cases, doubled ones counted twice; counted no further than beyond `MOST_CASES`."""
    count = spec.draws or 1
    for values in grid_axes(spec.grid).values():
        if count > MOST_CASES:
            break
        count *= len(values)
    return count


def configurations(spec: CampaignSpec) -> Iterator[dict[str, Any]]:
    """Configurations of the cases, the grid's last axis and then the draws changing fastest."""
    grid, draw = grid_axes(spec.grid), draw_axes(spec.draw)
    for number, values in enumerate(itertools.product(*grid.values())):
        chosen = dict(zip(grid, values, strict=True))
        for k in range(spec.draws or 1):
            drawn = dict[str, Any]()
            if draw:
                rng = np.random.default_rng([spec.draw_seed, number, k])
                drawn = {name: _drawn(draw[name], rng) for name in sorted(draw)}
            yield _nested(spec.fixed, chosen | drawn)


def axis_names(spec: CampaignSpec) -> list[str]:
    """Names of the axes, those of the grid first."""
    return [*grid_axes(spec.grid), *draw_axes(spec.draw)]


def grid_axes(table: Mapping[str, Any]) -> dict[str, list[Any]]:
    """Values of each axis of a grid."""
    axes = {}
    for name, value in _leaves(table, lambda v: set(v) == _COUNT):
        if isinstance(value, dict):
            first, count = value.get("first"), value.get("count")
            if type(first) is not int or type(count) is not int or count < 1:
                raise ValueError(f"axis {name} of [grid] needs whole numbers first and count ≥ 1")
            if count > MOST_CASES or abs(first) > MOST_WHOLE - count:
                raise ValueError(f"axis {name} of [grid] has too large a first or count")
            value = list(range(first, first + count))
        if not isinstance(value, list):
            raise ValueError(f"axis {name} of [grid] is no list; one value belongs into [fixed]")
        if not value:
            raise ValueError(f"axis {name} of [grid] is empty, so that there is no case")
        axes[name] = value
    return axes


def draw_axes(table: Mapping[str, Any]) -> dict[str, tuple[str, list[Any]]]:
    """Distribution of each axis that is drawn."""
    axes = {}
    for name, value in _leaves(table, lambda v: len(v) == 1 and next(iter(v)) in DISTRIBUTIONS):
        if not isinstance(value, dict):
            raise ValueError(f"axis {name} of [draw] needs one of {', '.join(DISTRIBUTIONS)}")
        ((form, limits),) = value.items()
        if not isinstance(limits, list) or not limits:
            raise ValueError(f"axis {name} of [draw] has nothing to draw from")
        if form != "choice":
            whole = form == "integers"
            kinds = (int,) if whole else (int, float)
            if len(limits) != 2 or not all(type(v) in kinds for v in limits):
                raise ValueError(f"axis {name} of [draw] needs two {'whole ' * whole}numbers")
            low, high = limits
            if not low < high or (form == "log_uniform" and low <= 0):
                positive = ", the lower one positive" if form == "log_uniform" else ""
                raise ValueError(f"axis {name} of [draw] needs two rising limits{positive}")
            if not _drawable(low, high, whole):
                raise ValueError(f"axis {name} of [draw] has limits too far apart")
        axes[name] = (form, limits)
    return axes


def flat(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Values of nested tables and lists of tables by their dotted names."""
    found: dict[str, Any] = {}
    for name, value in table.items():
        if isinstance(value, dict):
            found |= flat(value, f"{prefix}{name}.")
        elif isinstance(value, list) and value and all(isinstance(v, dict) for v in value):
            found |= flat({str(k): v for k, v in enumerate(value)}, f"{prefix}{name}.")
        else:
            found[prefix + name] = value
    return found


def _leaves(table: Mapping[str, Any], is_axis: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in table.items():
        if isinstance(value, dict) and value and not is_axis(value):
            yield from _leaves(value, is_axis, f"{prefix}{name}.")
        else:
            yield prefix + name, value


def _drawable(low: float, high: float, whole: bool) -> bool:
    """Whether NumPy can draw between two limits."""
    if whole:
        return low >= -MOST_WHOLE and high <= MOST_WHOLE
    try:
        return math.isfinite(float(high) - float(low))
    except OverflowError:  # a whole number without a double
        return False


def _drawn(axis: tuple[str, list[Any]], rng: np.random.Generator) -> Any:
    form, limits = axis
    if form == "choice":
        return limits[int(rng.integers(len(limits)))]
    low, high = limits
    if form == "integers":
        return int(rng.integers(low, high, endpoint=True))
    if form == "log_uniform":
        return float(np.exp(rng.uniform(math.log(low), math.log(high))))
    return float(rng.uniform(low, high))


def _nested(fixed: Mapping[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """Fixed values with those of the axes at their places; the fixed ones stay as they are."""
    result = {n: dict(v) if isinstance(v, dict) else v for n, v in fixed.items()}
    for name, value in values.items():
        *parents, last = name.split(".")
        place = result
        for parent in parents:
            place[parent] = dict(place.get(parent, {}))
            place = place[parent]
        place[last] = value
    return result
