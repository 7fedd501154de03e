"""Specification of a campaign: kind, fixed values, grid and draw, and the resulting configurations.

Tables may be nested: `[grid.effects]` with `backlash = [0, 0.006]` is an axis `effects.backlash`.
Draw k depends only on the campaign's seed, on k and on the number of its grid combination, so a
campaign with more draws contains the cases of one with fewer.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import convert, read_toml

MOST_CASES: Final = 1_000_000
"""Largest number of cases: their keys alone take 300 MB [assumed]."""
MOST_WHOLE: Final = 2**63 - 1
"""Largest whole number of an axis, limited by seeds and by NumPy's draws."""
DISTRIBUTIONS: Final = ("uniform", "log_uniform", "integers", "choice")
_COUNT: Final = {"first", "count"}

Axes = dict[str, Any]


class CampaignSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Contents of the file."""

    kind: str  # sil, fmu, gap, rig, or a module with your own kind
    name: str = ""  # Heading of the page
    fixed: dict[str, Any] = {}  # Values common to all cases
    # Axes whose combinations are the cases: a list of values each, or `{first, count}`
    grid: dict[str, Any] = {}
    # Random axes: `{uniform = [a, b]}`, `{log_uniform = [a, b]}`, `{integers = [a, b]}` (including
    # both ends), `{choice = […]}`
    draw: dict[str, Any] = {}
    draws: int | None = None  # Number of draws for each combination of the grid
    draw_seed: int = 0


def read_spec(path: Path) -> CampaignSpec:
    """Read and check the file of a campaign."""
    spec = convert(
        read_toml(path, "write one, see docs/campaigns.md"), CampaignSpec, path,
        "is no campaign", "see docs/campaigns.md",
    )  # fmt: skip
    return check_spec(spec, path)


def check_spec(spec: CampaignSpec, path: Path) -> CampaignSpec:
    """Check the axes and the number of cases of a campaign, and return it."""
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
    """Dotted names of the fixed values; a list is one value, because no axis can be inside it."""
    for name, value in table.items():
        if isinstance(value, dict):
            yield from _fixed_names(value, f"{prefix}{name}.")
        else:
            yield prefix + name


def _clash(places: Sequence[tuple[str, str]]) -> str:
    """Describe two places of which one is equal to, or inside, the other; "" if there are none."""
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
    """Return the number of cases, including duplicates; above `MOST_CASES` it is a lower bound."""
    count = spec.draws or 1
    for values in grid_axes(spec.grid).values():
        if count > MOST_CASES:
            break
        count *= len(values)
    return count


def configurations(spec: CampaignSpec) -> Iterator[dict[str, Any]]:
    """Yield the configurations of the cases; draws change fastest, then the grid's last axis."""
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
    """Return the names of the axes, those of the grid first."""
    return [*grid_axes(spec.grid), *draw_axes(spec.draw)]


def grid_axes(table: Mapping[str, Any]) -> dict[str, list[Any]]:
    """Return the values of each axis of a grid."""
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
    """Return the distribution of each random axis, with its limits or choices."""
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
    """Flatten nested tables and lists of tables to values by dotted name."""
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
