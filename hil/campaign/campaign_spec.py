"""File of a campaign: kind, fixed values, grid and draw, and the configurations that follow.

Names of the tables may be nested: `[grid.effects]` with `backlash = [0, 0.006]` is an axis
`effects.backlash`. Draw k of a campaign depends on its seed and on k alone, so that a campaign with
more draws holds the cases of one with fewer.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from firmware_py.errors import InputError
from firmware_py.files.input_files import convert, read_toml

MOST_CASES: Final = 1_000_000
"""Cases of the largest campaign: their keys alone take 300 MB [assumed]."""
DISTRIBUTIONS: Final = ("uniform", "log_uniform", "integers", "choice")
_COUNT: Final = {"first", "count"}

Axes = dict[str, Any]


class CampaignSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Content of the file.

    Attributes
    ----------
    kind : str
        sil, fmu, gap, rig, or a module with a kind of one's own.
    name : str
        Heading of the page.
    fixed : dict
        Values that all cases share.
    grid : dict
        Axes of which every combination is a case: a list of values, or `{first, count}`.
    draw : dict
        Axes that are drawn at random: `{uniform = [a, b]}`, `{log_uniform = [a, b]}`,
        `{integers = [a, b]}` (both ends included), `{choice = […]}`.
    draws : int
        Draws of each combination of the grid.
    draw_seed : int
        Of the draws.
    """

    kind: str
    name: str = ""
    fixed: dict[str, Any] = {}
    grid: dict[str, Any] = {}
    draw: dict[str, Any] = {}
    draws: int | None = None
    draw_seed: int = 0


def read_spec(path: Path) -> CampaignSpec:
    """Read the file of a campaign.

    Parameters
    ----------
    path : Path
        TOML file.

    Raises
    ------
    InputError
        If it is missing or damaged, an axis is empty, of a wrong form or stands twice, or it makes
        no case or too many.
    """
    spec = convert(
        read_toml(path, "write one, see docs/campaigns.md"), CampaignSpec, path,
        "is no campaign", "see docs/campaigns.md",
    )  # fmt: skip
    return check_spec(spec, path)


def check_spec(spec: CampaignSpec, path: Path) -> CampaignSpec:
    """Return a campaign whose axes can be used.

    Parameters
    ----------
    spec : CampaignSpec
        As read.
    path : Path
        For the message.

    Raises
    ------
    InputError
        As `read_spec`.
    """
    try:
        grid, draw = grid_axes(spec.grid), draw_axes(spec.draw)
    except ValueError as error:
        raise InputError(path, str(error), "see docs/campaigns.md") from None
    places = [("fixed", name) for name in flat(spec.fixed)]
    places += [("grid", name) for name in grid] + [("draw", name) for name in draw]
    for (table, name), (other_table, other) in itertools.combinations(places, 2):
        if (
            name == other
            or f"{name}.".startswith(f"{other}.")
            or f"{other}.".startswith(f"{name}.")
        ):
            raise InputError(
                path, f"{name} of [{table}] and {other} of [{other_table}] set the same value",
                "keep one of them",
            )  # fmt: skip
    if draw and spec.draws is None:
        raise InputError(path, "has a table [draw] but no number of draws", "add draws = 100")
    if spec.draws is not None and (spec.draws < 1 or not draw):
        wrong = f"draws = {spec.draws}" + ("" if draw else " without a table [draw]")
        raise InputError(path, f"has {wrong}", "give 1 or more, and what to draw")
    if spec.draw_seed < 0:
        raise InputError(path, f"has draw_seed = {spec.draw_seed}", "give 0 or more")
    if (count := case_count(spec)) > MOST_CASES:
        raise InputError(path, f"makes {count} cases", f"keep to {MOST_CASES} in one campaign")
    return spec


def case_count(spec: CampaignSpec) -> int:
    """Number of cases, doubled ones counted twice."""
    return math.prod(len(values) for values in grid_axes(spec.grid).values()) * (spec.draws or 1)


def configurations(spec: CampaignSpec) -> Iterator[dict[str, Any]]:
    """Configurations of the cases, the grid's last axis and then the draws changing fastest.

    Parameters
    ----------
    spec : CampaignSpec
        Of `read_spec`.
    """
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
    """Values of each axis of a grid.

    Parameters
    ----------
    table : mapping
        `[grid]` of the file.

    Raises
    ------
    ValueError
        If an axis is empty, or is no list.
    """
    axes = {}
    for name, value in _leaves(table, lambda v: set(v) == _COUNT):
        if isinstance(value, dict):
            if not all(type(v) is int for v in value.values()) or value["count"] < 1:
                raise ValueError(f"axis {name} of [grid] needs whole numbers first and count ≥ 1")
            value = list(range(value["first"], value["first"] + value["count"]))
        if not isinstance(value, list):
            raise ValueError(f"axis {name} of [grid] is no list; one value belongs into [fixed]")
        if not value:
            raise ValueError(f"axis {name} of [grid] is empty, so that there is no case")
        axes[name] = value
    return axes


def draw_axes(table: Mapping[str, Any]) -> dict[str, tuple[str, list[Any]]]:
    """Distribution of each axis that is drawn.

    Parameters
    ----------
    table : mapping
        `[draw]` of the file.

    Raises
    ------
    ValueError
        If an axis has no distribution, or bounds that cannot be.
    """
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
            if not low < high or (form == "log_uniform" and low <= 0) or not math.isfinite(high):
                positive = ", the lower one positive" if form == "log_uniform" else ""
                raise ValueError(f"axis {name} of [draw] needs two rising limits{positive}")
        axes[name] = (form, limits)
    return axes


def flat(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Values of nested tables and lists of tables by their dotted names.

    Parameters
    ----------
    table : mapping
        Nested.
    prefix : str
        In front of every name.

    Examples
    --------
    >>> flat({"a": 1, "b": {"c": 2, "d": [{"e": 3}]}})
    {'a': 1, 'b.c': 2, 'b.d.0.e': 3}
    """
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
