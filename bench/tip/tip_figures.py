"""Error and coverage of the contenders by part of a run, and the figures that the claims state.

Coverage is counted on the axes along which the tip moves (`models.learning.axis_coverage`): mean
over them, worst and best of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bench.tip.tip_answers import CONTENDERS, Answer
from bench.tip.tip_runs import SECONDS, TipRun
from models.learning.axis_coverage import MOVING_AXES

PARTS: Final = ("rest", "motion", "glide", "stop", "free decay")
FEWEST_ROWS: Final = 20
"""Rows of a part below which its coverage is not compared: one row would be more than 5 %."""

Figures = dict[str, float | str]


def figures(run: TipRun, answers: Mapping[str, Answer]) -> dict[str, dict[str, Figures]]:
    """Figures by contender and part of the run; "all" for all parts."""
    found: dict[str, dict[str, Figures]] = {}
    known = np.isfinite(run.tip_m).all(axis=1)
    for name in CONTENDERS:
        answer = answers[name]
        error_m = run.tip_m - answer.tip_m
        distance_m = np.linalg.norm(error_m, axis=1)
        inside = np.abs(error_m) <= answer.half_width_m
        found[name] = {}
        for part in ("all", *PARTS):
            rows = known & ((run.part == part) | (part == "all"))
            if not rows.any():
                continue
            trusted = rows & answer.in_range
            found[name][part] = {
                "rows": int(rows.sum()),
                "mean_m": float(distance_m[rows].mean()),
                "max_m": float(distance_m[rows].max()),
                **_coverage(inside[rows], run.dof, "coverage"),
                "in_range": float(answer.in_range[rows].mean()),
                "rows_in_range": int(trusted.sum()),
                **_coverage(inside[trusted], run.dof, "coverage_in_range"),
                "max_in_range_m": float(distance_m[trusted].max(initial=0.0)),
                "half_width_m": float(answer.half_width_m[rows].mean()),
            }
    return found


def _coverage(inside: NDArray[np.bool_], dof: int, name: str) -> Figures:
    """Mean over the axes that move, least, and most; 1 where there is no row."""
    axes = MOVING_AXES[dof]
    by_axis = inside[:, list(axes)].mean(axis=0) if len(inside) else np.ones(len(axes))
    return {
        name: float(by_axis.mean()),
        f"{name}_least": float(by_axis.min()),
        f"{name}_least_axis": "xyz"[axes[int(by_axis.argmin())]],
        f"{name}_most": float(by_axis.max()),
    }


def claimed_figures(document: Mapping[str, Any]) -> dict[str, float | str]:
    """Figures that the claims state, of the deployed predictor."""
    nominal = {name: run["deployed"] for name, run in document["nominal"].items()}
    motions = [nominal[name]["all"] for name in SECONDS]
    swinging = [nominal["decay"]["all"], nominal["stopped"]["stop"]]
    parts = list(_parts(nominal, "rows"))
    smallest, where = min((p["coverage_least"], place) for place, p in parts)
    found: dict[str, float | str] = {
        "mean_m": max(m["mean_m"] for m in motions),
        "max_m": max(m["max_m"] for m in motions),
        "swinging_max_in_range_m": max(m["max_in_range_m"] for m in swinging),
        "decay_in_range": nominal["decay"]["free decay"]["in_range"],
        "coverage_smallest": smallest,
        "coverage_smallest_where": where,
        "coverage_largest": max(p["coverage_most"] for _, p in parts),
        "coverage_mean": float(np.mean([m["coverage"] for m in motions])),
    }
    if document["wrong"]:
        found |= _with_wrong_plants(document["wrong"])
    return found


def _with_wrong_plants(wrong: Mapping[str, Any]) -> dict[str, float | str]:
    runs = {
        f"{kind}: {name}": run["deployed"]
        for kind, by_name in wrong.items()
        for name, run in by_name.items()
    }
    parts = list(_parts(runs, "rows_in_range"))
    smallest, where = min((p["coverage_in_range_least"], place) for place, p in parts)
    enough = [p["coverage_in_range_least"] >= 0.9 for _, p in parts]
    whole = [run["all"] for run in runs.values() if run["all"]["rows_in_range"]]
    return {
        "wrong_coverage_in_range_smallest": smallest,
        "wrong_coverage_in_range_smallest_where": where,
        "wrong_coverage_in_range_mean": float(np.mean([w["coverage_in_range"] for w in whole])),
        "wrong_coverage_in_range_run_least": min(w["coverage_in_range_least"] for w in whole),
        "wrong_parts_covered": float(np.mean(enough)),
        "wrong_max_in_range_m": max(w["max_in_range_m"] for w in whole),
    }


def _parts(
    runs: Mapping[str, Mapping[str, Mapping[str, Any]]], rows: str
) -> Iterable[tuple[str, Mapping[str, Any]]]:
    """Parts of the runs that have rows enough, with their names."""
    for name, by_part in runs.items():
        for part, found in by_part.items():
            if part != "all" and found[rows] >= FEWEST_ROWS:
                yield f"{name}, {part}", found
