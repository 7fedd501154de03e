"""The paper's figures 12 to 15, drawn from `study.json`: how well polynomials predict."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from firmware_py.display_units import LENGTH
from models.shared.palette import BLUE, INK, ordered_colours
from models.shared.svg_drawing import Drawing, Figure, log_axis

Json = dict[str, Any]
Studies = dict[str, Json]
"""By what they were trained on."""

TEST: Final = "trial_2"
VARIANTS: Final = {
    "with_di": ("true DI", "solid"),
    "estimated_di": ("estimated DI (robot)", "dashed"),
    "without_di": ("without DI", "dotted"),
}
FOLDS: Final = {
    "leave_one_payload_out_m": ("payloads left out of trial 1", "dashed"),
    "blocks_m": ("blocks of time left out of trial 1", "dotted"),
}


def error_figures(studies: Studies) -> list[Figure]:
    """Error over time and degree, and what DI takes off it; one panel per study.

    Studies without a trial 2 have none of these figures.
    """
    tested = {name: study for name, study in studies.items() if TEST in study["tests"]}
    if not tested:
        return []
    return [_error_over_time(tested), _error_over_degree(tested), _gain_by_di(tested)]


def _error_over_time(studies: Studies) -> Figure:
    panels = []
    everything = [
        LENGTH.factor * v
        for study in studies.values()
        for curve in study["series"]["error"][TEST]["euclidean_distance_m"].values()
        for v in curve
    ]
    for name, study in studies.items():
        error = study["series"]["error"][TEST]
        curves = error["euclidean_distance_m"]
        with Drawing() as (drawing, ax):
            for curve, colour in zip(curves.values(), ordered_colours(len(curves)), strict=True):
                ax.plot(error["time_s"], LENGTH.shown(curve), color=colour, linewidth=1.0)
            ax.set(xlabel="time in s", ylabel=LENGTH.label("distance"))
            log_axis(ax, everything)
        listed = ", ".join(f"degree {d} {LENGTH.text(np.mean(c))}" for d, c in curves.items())
        panels.append(
            drawing.panel(
                name,
                f"Euclidean distance over time, {name}, mean over payloads: {listed} on average.",
            )
        )
    degrees = list(next(iter(studies.values()))["series"]["error"][TEST]["euclidean_distance_m"])
    legend = [
        (c, f"degree {d}", "solid")
        for d, c in zip(degrees, ordered_colours(len(degrees)), strict=True)
    ]
    return Figure(
        "Error of the predictors over time",
        "With true DI; trained on trial 1, tested on trial 2, mean over the payloads.",
        panels, "12 and 13", legend,
    )  # fmt: skip


def _error_over_degree(studies: Studies) -> Figure:
    panels = []
    everything = [
        LENGTH.factor * v
        for study in studies.values()
        for v in (
            *study["mean_euclidean_distance_m"][TEST]["pooled"]["with_di"].values(),
            *(
                fold[kind]
                for fold in study["cross_validation"]["with_di"].values()
                for kind in FOLDS
                if kind in fold
            ),
        )
    ]
    for name, study in studies.items():
        mean = study["mean_euclidean_distance_m"][TEST]["pooled"]["with_di"]
        std = study["std_euclidean_distance_m"][TEST]["pooled"]["with_di"]
        folds = study["cross_validation"]["with_di"]
        degrees = [int(d) for d in mean]
        centre, band = (LENGTH.shown([table[d] for d in mean]) for table in (mean, std))
        with Drawing() as (drawing, ax):
            ax.fill_between(degrees, np.maximum(centre - band, 1e-3), centre + band,
                            color=BLUE, alpha=0.15, linewidth=0)  # fmt: skip
            ax.plot(degrees, centre, color=BLUE, marker="o", markersize=4)
            for kind, (_, line) in FOLDS.items():
                if kind in folds["1"]:
                    held_out = [LENGTH.factor * folds[d][kind] for d in mean]
                    ax.plot(degrees, held_out, color=INK, linestyle=line)
            ax.set(xlabel="degree", ylabel=LENGTH.label("mean distance"), xticks=degrees)
            log_axis(ax, everything)
        listed = ", ".join(f"{v:.1f} mm at degree {k}" for k, v in enumerate(centre, 1))
        panels.append(drawing.panel(name, f"Mean Euclidean distance on trial 2, {name}: {listed}."))
    return Figure(
        "Error over the degree",
        "With true DI, pooled over payloads; the band is one standard deviation of the samples. "
        "The degree is chosen by payloads left out of trial 1, never by trial 2.",
        panels, "14",
        [(BLUE, "trial 2", "solid"), *((INK, text, line) for text, line in FOLDS.values())],
    )  # fmt: skip


def _gain_by_di(studies: Studies) -> Figure:
    panels = []
    everything = [
        LENGTH.factor * v
        for study in studies.values()
        for by_degree in study["mean_euclidean_distance_m"][TEST]["pooled"].values()
        for v in by_degree.values()
    ]
    for name, study in studies.items():
        table = study["mean_euclidean_distance_m"][TEST]["pooled"]
        with Drawing() as (drawing, ax):
            for variant, (_, dash) in VARIANTS.items():
                degrees = [int(d) for d in table[variant]]
                ax.plot(
                    degrees, [LENGTH.factor * v for v in table[variant].values()],
                    color=BLUE, linestyle=dash, marker="o", markersize=3.5,
                )  # fmt: skip
            ax.set(xlabel="degree", ylabel=LENGTH.label("mean distance"), xticks=degrees)
            log_axis(ax, everything)
        listed = "; ".join(
            f"{label} {', '.join(f'{LENGTH.factor * v:.1f}' for v in table[variant].values())} mm"
            for variant, (label, _) in VARIANTS.items()
        )
        panels.append(
            drawing.panel(name, f"Mean Euclidean distance by degree 1 to 6, {name}: {listed}.")
        )
    return Figure(
        "What DI is worth",
        "Trained on trial 1, tested on trial 2. The robot has no motion capture: it gets the "
        "predictor that was trained on estimated DI.",
        panels, "15", [(INK, label, dash) for label, dash in VARIANTS.values()],
    )  # fmt: skip
