"""Figures of the benchmark over all its results, and those of a peer beside them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from bench.gap.bench_kind import bench_results
from bench.gap.scores.fraction_interval import fraction_with_interval
from bench.gap.scores.result_predicates import (
    Result,
    first_turn,
    hidden_separation,
    is_among_first,
    is_clear,
    is_first_name_right,
    is_in_class,
    is_pair_in_class,
    is_said_outside,
    is_strength_covered,
    strength_change,
)

FAINT: Final = (3.5, 8.0)


def benchmark_figures(directory: Path) -> dict[str, Any]:
    """Figures over every result in a directory."""
    results = list(bench_results(directory).values())
    possible = [r for r in results if "impossible" not in r]
    of = lambda kind: [r for r in possible if r["case"]["kind"] == kind]  # noqa: E731
    singles = of("single")
    detected = [r for r in singles if r["named"]]
    clear = [r for r in singles if is_clear(r)]
    faint = [r for r in singles if FAINT[0] <= hidden_separation(r) < FAINT[1]]
    sealed = [r for r in detected if r["sealed"] and r["sealed"][0] > 1.1 * r["sealed"][2]]
    return {
        "cases": len(results),
        "impossible": len(results) - len(possible),
        "detected": fraction_with_interval([bool(r["named"]) for r in singles]),
        "top_1": fraction_with_interval([is_first_name_right(r) for r in detected]),
        "top_1_clear": fraction_with_interval([is_first_name_right(r) for r in clear]),
        "top_1_faint": fraction_with_interval([is_first_name_right(r) for r in faint]),
        "top_2": fraction_with_interval([is_among_first(r, 2) for r in detected]),
        "top_1_unique": fraction_with_interval(
            [is_first_name_right(r) for r in detected if not first_turn(r)[1]]
        ),
        "class_of_named": fraction_with_interval([is_in_class(r) for r in detected]),
        "nothing_beside": fraction_with_interval([len(r["named"]) == 1 for r in detected]),
        "false_alarms": fraction_with_interval([r["verdict"] != "no gap" for r in of("null")]),
        "largest_on_nulls": sorted(round(r["largest"], 2) for r in of("null"))[-5:],
        "pairs_exact": fraction_with_interval(
            [set(r["named"]) == set(r["case"]["hidden"]) for r in of("pair")]
        ),
        "pairs_in_class": fraction_with_interval([is_pair_in_class(r) for r in of("pair")]),
        "outside_said": fraction_with_interval(
            [is_said_outside(r) for r in of("outside") if r["separable"]]
        ),
        "outside_said_all": fraction_with_interval([is_said_outside(r) for r in of("outside")]),
        "inside_said": fraction_with_interval([is_said_outside(r) for r in detected]),
        "fraction_of_gap_removed": _quantiles([_removed(r) for r in sealed]),
        "parameter_error": _quantiles([e for r in clear if (e := _parameter(r)) is not None]),
        "coverage": fraction_with_interval(
            [c for r in detected if (c := is_strength_covered(r)) is not None]
        ),
        "wall_s": _quantiles([r["wall_s"] for r in possible if "wall_s" in r]),
        "cpu_s": _quantiles([r["cpu_s"] for r in possible if "cpu_s" in r]),
        "peer": peer_comparison(directory),
    }


def peer_comparison(directory: Path) -> dict[str, Any]:
    """Figures of PySINDy (`bench.gap.peer`) and of ours, on the cases that both have.

    Of a pair the first two names count, whatever else is named.
    """
    peer = {p.stem: json.loads(p.read_text()) for p in sorted(directory.glob("peer/*.json"))}
    results = bench_results(directory)
    ours = {key: results[key] for key in peer}
    return {"pysindy": _plain(list(peer.values())), "ours": _plain(list(ours.values()))}


def _plain(results: Sequence[Result]) -> dict[str, Any]:
    of = lambda kind: [r for r in results if r["case"]["kind"] == kind]  # noqa: E731
    singles = of("single")
    return {
        "top_1_detected": fraction_with_interval(
            [is_first_name_right(r) for r in singles if r["named"]]
        ),
        "top_1_all": fraction_with_interval([is_first_name_right(r) for r in singles]),
        "false_alarms": fraction_with_interval([r["verdict"] != "no gap" for r in of("null")]),
        "pairs_exact": fraction_with_interval(
            [set(r["named"][:2]) == set(r["case"]["hidden"]) for r in of("pair")]
        ),
    }


def _removed(r: Result) -> float:
    before, after, floor = r["sealed"]
    return float((before - after) / (before - floor))


def _parameter(r: Result) -> float | None:
    change = strength_change(r)
    return abs(change[0] / change[2] - 1) if change else None


def _quantiles(values: Sequence[float]) -> dict[str, Any]:
    if not values:
        return {"of": 0}
    low, middle, high = np.quantile(values, [0.1, 0.5, 0.9])
    return {"median": float(middle), "p10": float(low), "p90": float(high), "of": len(values)}
