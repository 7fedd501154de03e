"""Error figures of the study: distance over time and degree, and the gain by DI (Figs. 12–15)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from firmware_py.core.units import LENGTH, TIME
from models.shared.drawing import Drawing, log_axis
from models.shared.pages import Figure, LegendEntry, Panel
from models.shared.palette import BLUE, INK, ordered_colours
from models.study.document import StudyDocument

Studies = Mapping[str, StudyDocument]
"""Studies by their training data."""

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
DISTANCE: Final = LENGTH.label("mean distance")


def error_figures(studies: Studies) -> list[Figure]:
    """Draw the error figures, one panel for each study with a trial 2."""
    tested = {name: study for name, study in studies.items() if TEST in study.tests}
    if not tested:
        return []
    return [_error_over_time(tested), _error_over_degree(tested), _gain_by_di(tested)]


def _error_over_time(studies: Studies) -> Figure:
    everything = [
        LENGTH.shown(curve)
        for study in studies.values()
        for curve in study.series.error[TEST].euclidean_distance_m.values()
    ]
    panels = []
    for name, study in studies.items():
        curves = study.series.error[TEST].euclidean_distance_m
        with Drawing() as (drawing, ax):
            for curve, colour in zip(curves.values(), ordered_colours(len(curves)), strict=True):
                time_s = study.series.error[TEST].time_s
                ax.plot(time_s, LENGTH.shown(curve), color=colour, linewidth=1.0)
            ax.set(xlabel=TIME.label("time"), ylabel=LENGTH.label("distance"))
            log_axis(ax, np.concatenate(everything))
        listed = ", ".join(f"degree {d} {LENGTH.text(np.mean(c))}" for d, c in curves.items())
        alt = f"Euclidean distance over time, {name}, mean over payloads: {listed} on average."
        panels.append(drawing.panel(name, alt))
    degrees = list(next(iter(studies.values())).series.error[TEST].euclidean_distance_m)
    legend = [
        LegendEntry(colour, f"degree {d}")
        for d, colour in zip(degrees, ordered_colours(len(degrees)), strict=True)
    ]
    return Figure(
        "Error of the predictors over time",
        "With true DI; trained on trial 1, tested on trial 2, mean over the payloads.",
        panels, "12 and 13", legend,
    )  # fmt: skip


def _error_over_degree(studies: Studies) -> Figure:
    everything = [
        *(_pooled(study, "with_di") for study in studies.values()),
        *(_folds(study, kind) for study in studies.values() for kind in FOLDS),
    ]
    panels: list[Panel] = []
    for name, study in studies.items():
        table = study.std_euclidean_distance_m[TEST]["pooled"]["with_di"]
        centre, band = _pooled(study, "with_di"), LENGTH.shown(list(table.values()))
        degrees = [int(d) for d in table]
        with Drawing() as (drawing, ax):
            ax.fill_between(degrees, np.maximum(centre - band, 1e-3), centre + band,
                            color=BLUE, alpha=0.15, linewidth=0)  # fmt: skip
            ax.plot(degrees, centre, color=BLUE, marker="o", markersize=4)
            for kind, (_, line) in FOLDS.items():
                if len(held_out := _folds(study, kind)):
                    ax.plot(degrees, held_out, color=INK, linestyle=line)
            ax.set(xlabel="degree", ylabel=DISTANCE, xticks=degrees)
            log_axis(ax, np.concatenate(everything))
        listed = ", ".join(f"{v:.1f} mm at degree {k}" for k, v in enumerate(centre, 1))
        panels.append(drawing.panel(name, f"Mean Euclidean distance on trial 2, {name}: {listed}."))
    return Figure(
        "Error over the degree",
        "With true DI, pooled over payloads; the band is one standard deviation of the samples. "
        "The degree is chosen by payloads left out of trial 1, never by trial 2.",
        panels, "14",
        [LegendEntry(BLUE, "trial 2"),
         *(LegendEntry(INK, text, line) for text, line in FOLDS.values())],
    )  # fmt: skip


def _gain_by_di(studies: Studies) -> Figure:
    everything = [_pooled(study, variant) for study in studies.values() for variant in VARIANTS]
    panels: list[Panel] = []
    for name, study in studies.items():
        table = study.mean_euclidean_distance_m[TEST]["pooled"]
        with Drawing() as (drawing, ax):
            for variant, (_, dash) in VARIANTS.items():
                degrees = [int(d) for d in table[variant]]
                ax.plot(
                    degrees, _pooled(study, variant),
                    color=BLUE, linestyle=dash, marker="o", markersize=3.5,
                )  # fmt: skip
            ax.set(xlabel="degree", ylabel=DISTANCE, xticks=degrees)
            log_axis(ax, np.concatenate(everything))
        listed = "; ".join(
            f"{label} {', '.join(f'{v:.1f}' for v in _pooled(study, variant))} mm"
            for variant, (label, _) in VARIANTS.items()
        )
        alt = f"Mean Euclidean distance by degree 1 to 6, {name}: {listed}."
        panels.append(drawing.panel(name, alt))
    return Figure(
        "Accuracy gained by DI",
        "Trained on trial 1, tested on trial 2. The robot has no motion capture: it uses the "
        "predictor that was trained on estimated DI.",
        panels, "15", [LegendEntry(BLUE, label, dash) for label, dash in VARIANTS.values()],
    )  # fmt: skip


def _pooled(study: StudyDocument, variant: str) -> np.ndarray:
    """Mean distance over all payloads by degree, in the display unit."""
    return LENGTH.shown(list(study.mean_euclidean_distance_m[TEST]["pooled"][variant].values()))


def _folds(study: StudyDocument, kind: str) -> np.ndarray:
    """Distance on held-out data by degree, in the display unit; empty without cross-validation."""
    values = [getattr(fold, kind) for fold in study.cross_validation["with_di"].values()]
    return LENGTH.shown([v for v in values if v is not None])
