"""Figures of the benchmark: fractions with their 95 % intervals, and the confusion matrix."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot
from scipy.stats import beta

from bench.gap.bench_kind import bench_results
from models.shared.gap_charts import draw_heat_map
from models.shared.svg_drawing import FILE_STYLE

CLEAR = 15.0
FAINT = (3.5, 8.0)


def clopper_pearson(count: int, total: int) -> tuple[float, float]:
    """Clopper-Pearson 95 % interval of a fraction.

    Parameters
    ----------
    count : int
        Of true rows.
    total : int
        Of all rows.
    """
    low = beta.ppf(0.025, count, total - count + 1) if count else 0.0
    high = beta.ppf(0.975, count + 1, total - count) if count < total else 1.0
    return float(low), float(high)


def fraction_with_interval(rows: Sequence[bool]) -> dict[str, Any]:
    """Fraction of true rows, with its interval."""
    if not rows:
        return {"of": 0}
    low, high = clopper_pearson(sum(rows), len(rows))
    return {"fraction": sum(rows) / len(rows), "interval": [low, high], "of": len(rows)}


def benchmark_figures(directory: Path) -> dict[str, Any]:
    """Figures over every result in a directory."""
    results = list(bench_results(directory).values())
    possible = [r for r in results if "impossible" not in r]
    of = lambda kind: [r for r in possible if r["case"]["kind"] == kind]  # noqa: E731
    singles = of("single")
    detected = [r for r in singles if r["named"]]
    clear = [r for r in singles if _own(r) >= CLEAR]
    faint = [r for r in singles if FAINT[0] <= _own(r) < FAINT[1]]
    sealed = [r for r in detected if r["sealed"] and r["sealed"][0] > 1.1 * r["sealed"][2]]
    return {
        "cases": len(results),
        "impossible": len(results) - len(possible),
        "detected": fraction_with_interval([bool(r["named"]) for r in singles]),
        "top_1": fraction_with_interval([is_first_name_right(r) for r in detected]),
        "top_1_clear": fraction_with_interval([is_first_name_right(r) for r in clear]),
        "top_1_faint": fraction_with_interval([is_first_name_right(r) for r in faint]),
        "top_2": fraction_with_interval([_top(r, 2) for r in detected]),
        "top_1_unique": fraction_with_interval(
            [is_first_name_right(r) for r in detected if not r["look_alikes"][0]]
        ),
        "class": fraction_with_interval([is_in_class(r) for r in detected]),
        "nothing_beside": fraction_with_interval([len(r["named"]) == 1 for r in detected]),
        "false_alarms": fraction_with_interval([r["verdict"] != "no gap" for r in of("null")]),
        "largest_on_nulls": sorted(round(r["largest"], 2) for r in of("null"))[-5:],
        "pairs_exact": fraction_with_interval(
            [set(r["named"]) == set(r["case"]["hidden"]) for r in of("pair")]
        ),
        "pairs_in_class": fraction_with_interval([_pair_in_class(r) for r in of("pair")]),
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


def _plain(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
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


def confusion_matrix_svg(directory: Path) -> str:
    """Which effect was named for which: an SVG with counts."""
    cells: dict[tuple[str, str], float] = {}
    for r in bench_results(directory).values():
        if "impossible" in r or r["case"]["kind"] not in ("single", "null"):
            continue
        true = next(iter(r["case"]["hidden"]), "(none)")
        named = r["named"][0] if r["named"] else "(nothing)"
        cells[true, named] = cells.get((true, named), 0.0) + 1
    rows, columns = sorted({t for t, _ in cells}), sorted({n for _, n in cells})
    text = io.StringIO()
    with pyplot.rc_context(FILE_STYLE):
        size_in = (2.5 + 0.4 * len(columns), 1.5 + 0.26 * len(rows))
        figure, ax = pyplot.subplots(figsize=size_in, layout="constrained")
        draw_heat_map(ax, rows, columns, cells, most=max(cells.values(), default=1.5))
        ax.set(xlabel="effect named first", ylabel="effect hidden")
        figure.savefig(text, format="svg", metadata={"Date": None})
        pyplot.close(figure)
    return text.getvalue()


def _own(r: dict[str, Any]) -> float:
    """d′ of the hidden effect in the first screen, in standard deviations of its d′ without one."""
    return max(
        ((v or 0.0) / r["null_standard_deviation"][e] for e, v in r["own"].items()), default=0.0
    )


def _true(r: dict[str, Any]) -> str:
    return str(next(iter(r["case"]["hidden"])))


def is_first_name_right(r: dict[str, Any]) -> bool:
    """Whether the hidden effect is the first name."""
    return _top(r, 1)


def _top(r: dict[str, Any], most: int) -> bool:
    return _true(r) in r["named"][:most]


def is_in_class(r: dict[str, Any]) -> bool:
    """Whether the hidden effect is the first name or one of its declared look-alikes."""
    alike = [e for c in r["look_alikes"][0] for e in c] if r["look_alikes"] else []
    return _true(r) in [*r["chosen"][0], *alike]


def _pair_in_class(r: dict[str, Any]) -> bool:
    """Whether both hidden effects are among two named ones or their declared look-alikes."""
    alike = [
        {*names, *(e for c in others for e in c)}
        for names, others in zip(r["chosen"], r["look_alikes"], strict=True)
        if set(names) <= set(r["named"])  # what was dropped again does not count
    ]
    if len(r["named"]) != 2:
        return False
    if len(alike) == 1:  # both in one turn
        return set(r["case"]["hidden"]) <= alike[0]
    return any(a in alike[0] and b in alike[1] for a, b in permutations(r["case"]["hidden"]))


def is_said_outside(r: dict[str, Any]) -> bool:
    """Whether the verdict says that an effect outside the catalogue is at work."""
    return bool(r["verdict"] == "not in the catalogue")


def _removed(r: dict[str, Any]) -> float:
    before, after, floor = r["sealed"]
    return float((before - after) / (before - floor))


def _change(r: dict[str, Any]) -> tuple[float, float, float] | None:
    """Estimated change of the strength, its standard error and the hidden strength."""
    if not is_first_name_right(r):
        return None
    value, error, before = r["estimates"][_true(r)][0]
    return value - before, error or 0.0, r["true"][_true(r)]


def _parameter(r: dict[str, Any]) -> float | None:
    change = _change(r)
    return abs(change[0] / change[2] - 1) if change else None


def is_strength_covered(r: dict[str, Any]) -> bool | None:
    """Whether the strength lies within 1.96 standard errors; None where the name is wrong."""
    change = _change(r)
    return abs(change[0] - change[2]) <= 1.96 * change[1] if change else None


def _quantiles(values: Sequence[float]) -> dict[str, Any]:
    if not values:
        return {"of": 0}
    low, middle, high = np.quantile(values, [0.1, 0.5, 0.9])
    return {"median": float(middle), "p10": float(low), "p90": float(high), "of": len(values)}
