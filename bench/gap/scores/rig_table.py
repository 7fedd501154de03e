"""Figures of the benchmark by rig and by group of effects.

Rigs for tuning are those that numbers of the workflow were set on; the others are for testing alone
(`models.rig.drawn_rig.rig_purpose`), and only their figures say how the workflow does on a rig that
it has never seen.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from bench.gap.bench_kind import bench_results
from bench.gap.scores.fraction_interval import fraction_with_interval
from bench.gap.scores.reliability import (
    largest_deviation,
    reliability_bins,
    reliability_table,
)
from bench.gap.scores.result_predicates import (
    Result,
    is_class_right,
    is_clear,
    is_first_name_right,
    is_in_class,
    is_larger_named,
    is_link_effect,
    is_pair_named,
    is_said_outside,
    is_strength_covered,
)
from models.gap.decision.posterior import DECIDED
from models.gap.settings import DEFAULT_SETTINGS
from models.rig.drawn_rig import rig_purpose

WORSE_FRACTION: Final = DEFAULT_SETTINGS.harm_fraction
"""Rise of a signal's error on data that nothing was fitted to, from which a plant is worse."""

Figures = dict[str, Any]


def rig_figures(results: Sequence[Result]) -> Figures:
    """Figures of some results."""
    possible = [r for r in results if "impossible" not in r]
    single = [r for r in possible if r["case"]["kind"] == "single"]
    null = [r for r in possible if r["case"]["kind"] == "null"]
    pairs = [r for r in possible if r["case"]["kind"] == "pair"]
    outside = [r for r in possible if r["case"]["kind"] == "outside"]
    sealed = [r for r in possible if r.get("sealed_tested", True)]
    decided = [r for r in possible if r["separable"]]
    clear = [r for r in single if is_clear(r)]
    link, servo = _by_group(single, link=True), _by_group(single, link=False)
    covered = [c for r in single if (c := is_strength_covered(r)) is not None]
    bins = reliability_bins(_said(decided))
    return {
        "cases": len(possible),
        "false_alarms": fraction_with_interval([r["verdict"] != "no gap" for r in null]),
        "first_servo_sensor": fraction_with_interval([is_first_name_right(r) for r in servo]),
        "first_link_payload_play": fraction_with_interval([is_first_name_right(r) for r in link]),
        "first_clear": fraction_with_interval([is_first_name_right(r) for r in clear]),
        "class": fraction_with_interval([is_class_right(r) for r in single]),
        "class_link": fraction_with_interval([is_class_right(r) for r in link]),
        "class_clear": fraction_with_interval([is_class_right(r) for r in clear]),
        "pairs_both": fraction_with_interval([is_pair_named(r) for r in pairs]),
        "pairs_larger": fraction_with_interval([is_larger_named(r) for r in pairs]),
        "wrongly_outside": fraction_with_interval([is_said_outside(r) for r in single]),
        "wrong_and_closed": fraction_with_interval([_is_wrong_and_closed(r) for r in single]),
        "strength_covered": fraction_with_interval(covered),
        "outside_said": fraction_with_interval(
            [is_said_outside(r) for r in outside if r["separable"]]
        ),
        "outside_said_all": fraction_with_interval([is_said_outside(r) for r in outside]),
        "probable_right": fraction_with_interval(
            [right for probability, right in _said(possible) if probability >= DECIDED]
        ),
        "brier": _brier(decided),
        "reliability": bins,
        "reliability_off": largest_deviation(bins),
        "worse": fraction_with_interval([_is_worse(r) for r in sealed]),
        "worse_than_plain": fraction_with_interval([_is_worse_than_plain(r) for r in sealed]),
        "unsaid_bounds": fraction_with_interval([bool(r["unsaid_bounds"]) for r in possible]),
        "worst_rise": max((x for r in possible for x in _rises(r)), default=0.0),
    }


def figures_by_rig(directory: Path) -> dict[str, Figures]:
    """Figures of every rig, of those for tuning, and of those for testing."""
    results = list(bench_results(directory).values())
    names = sorted({r["case"]["rig"] for r in results})
    purposes = {name: rig_purpose(name) for name in names}
    chosen: dict[str, Callable[[Result], bool]] = {
        f"all for {purpose}": lambda r, p=purpose: purposes[r["case"]["rig"]] == p  # type: ignore[misc]
        for purpose in sorted(set(purposes.values()))
    }
    chosen |= {name: lambda r, n=name: r["case"]["rig"] == n for name in names}  # type: ignore[misc]
    return {name: rig_figures([r for r in results if keep(r)]) for name, keep in chosen.items()}


def rig_table_text(figures: Mapping[str, Figures]) -> str:
    """Markdown tables: a row for each figure, then for each bin; a column for each rig."""
    columns = list(figures)
    lines = ["| figure | " + " | ".join(columns) + " |", "|---" * (len(columns) + 1) + "|"]
    rows = list(next(iter(figures.values()), {}))
    for row in rows:
        if row != "reliability":
            lines.append(f"| {row} | " + " | ".join(_cell(figures[c][row]) for c in columns) + " |")
    bins = reliability_table({c: figures[c]["reliability"] for c in columns})
    return "\n".join([*lines, *(["", bins] if bins else [])])


def _missing(r: Result) -> list[str]:
    """Effects that were hidden and could be named."""
    return [] if r["case"]["kind"] == "outside" else list(r["case"]["hidden"])


def _probabilities(r: Result) -> dict[str, float]:
    """Probability of each effect that it is missing, by the hypotheses of a result."""
    found: dict[str, float] = defaultdict(float)
    for effects, _, _, probability in r.get("hypotheses", ()):
        for effect in effects:
            found[effect] += probability
    return found


def _said(results: Iterable[Result]) -> list[tuple[float, bool]]:
    """Probability of each effect of some results that it is missing, and whether it was."""
    return [(p, e in _missing(r)) for r in results for e, p in _probabilities(r).items()]


def _brier(results: Sequence[Result]) -> float | None:
    """Mean over the cases of the sum of squares of probability less outcome, over the effects."""
    scores = []
    for r in results:
        probabilities, missing = _probabilities(r), _missing(r)
        effects = sorted({*probabilities, *missing})  # a sum of the same digits in every process
        scores.append(sum((probabilities.get(e, 0.0) - (e in missing)) ** 2 for e in effects))
    return float(np.mean(scores)) if scores else None


def _cell(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{value:.2f}"
    if not isinstance(value, dict):
        return str(value)
    return f"{round(value['fraction'] * value['of'])} of {value['of']}" if value["of"] else "–"


def _by_group(results: Sequence[Result], link: bool) -> list[Result]:
    return [r for r in results if is_link_effect(next(iter(r["case"]["hidden"]))) == link]


def _is_wrong_and_closed(r: Result) -> bool:
    """A wrong name, no look-alike, and a verdict that sends nobody to look again."""
    return bool(r["named"]) and not is_in_class(r) and r["verdict"] in ("closed", "reduced")


def _rises(r: Result) -> list[float]:
    """Rise of each signal's error on sealed trials, as a fraction of that before."""
    return [
        after / before - 1.0
        for trial in (r["sealed_rms"] or {}).values()
        for before, after, *_ in trial.values()
        if before > 0
    ]


def _is_worse(r: Result) -> bool:
    return any(rise > WORSE_FRACTION for rise in _rises(r))


def _is_worse_than_plain(r: Result) -> bool:
    """Whether a signal's error exceeds that before, and that where nothing is hidden."""
    return any(
        after > (1 + WORSE_FRACTION) * max([before, *plain])
        for trial in (r["sealed_rms"] or {}).values()
        for before, after, *plain in trial.values()
        if before > 0
    )
