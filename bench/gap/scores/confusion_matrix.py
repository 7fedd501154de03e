"""Confusion matrix of the benchmark: which effect was named for which."""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Iterable, Mapping

from matplotlib import pyplot

from bench.gap.scores.result_predicates import Result
from models.shared.gap_charts import draw_heat_map
from models.shared.svg_drawing import FILE_STYLE


def confusion_counts(results: Iterable[Result]) -> dict[tuple[str, str], float]:
    """Number of cases by hidden effect and first name; of cases with one effect or none."""
    return dict(
        Counter[tuple[str, str]](
            (
                next(iter(r["case"]["hidden"]), "(none)"),
                r["named"][0] if r["named"] else "(nothing)",
            )
            for r in results
            if "impossible" not in r and r["case"]["kind"] in ("single", "null")
        )
    )


def confusion_matrix_svg(cells: Mapping[tuple[str, str], float], title: str = "") -> str:
    """Which effect was named for which: an SVG with counts."""
    rows, columns = sorted({t for t, _ in cells}), sorted({n for _, n in cells})
    text = io.StringIO()
    with pyplot.rc_context(FILE_STYLE):
        size_in = (2.5 + 0.4 * len(columns), 1.5 + 0.26 * len(rows))
        figure, ax = pyplot.subplots(figsize=size_in, layout="constrained")
        draw_heat_map(ax, rows, columns, cells, most=max(cells.values(), default=1.5))
        ax.set(xlabel="effect named first", ylabel="effect hidden", title=title)
        figure.savefig(text, format="svg", metadata={"Date": None})
        pyplot.close(figure)
    return text.getvalue()
