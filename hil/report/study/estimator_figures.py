"""Figures of estimators and predictors: DI without motion capture, and tip error by payload."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from firmware_py.core.units import DEFORMATION, LENGTH, PAYLOAD, TIME
from models.shared.drawing import Drawing, log_axis
from models.shared.pages import Figure, LegendEntry
from models.shared.palette import AMBER, BLUE, GREEN, INK, MUTED
from models.study.document import StudyDocument

SOURCES: Final = {
    "true": ("motion capture", INK, "solid"),
    "observer": ("plant observer", BLUE, "dashed"),
    "lagged": ("lagged regressor", AMBER, "dotted"),
}
PREDICTORS: Final = {
    "rigid": ("rigid kinematics", MUTED, "solid"),
    "without": ("polynomial without DI", AMBER, "dotted"),
    "estimated": ("polynomial, estimated DI (robot)", BLUE, "solid"),
    "true": ("polynomial, true DI", INK, "dashed"),
    "observer": ("plant observer's own tip", GREEN, "solid"),
}


def test_words(name: str) -> str:
    """Return the label of a test's key: "trial 2", "unseen 20° motion"."""
    words = name.replace("_", " ")
    if words.startswith("unseen"):
        return words.replace("deg", "° motion")
    return words


def di_estimates(studies: Mapping[int, StudyDocument]) -> Figure:
    """Draw the DI of the heaviest payload over time, by source, on every test."""
    panels = []
    for dof, study in studies.items():
        for name, curves in study.series.estimates.items():
            with Drawing() as (drawing, ax):
                for source, (_, colour, dash) in SOURCES.items():
                    ax.plot(
                        curves.time_s, DEFORMATION.shown(getattr(curves, source)),
                        color=colour, linestyle=dash, linewidth=1.2,
                    )  # fmt: skip
                ax.set(xlabel=TIME.label("time"), ylabel=DEFORMATION.label("DI"), ylim=(0, None))
            judged = study.estimators[name]
            panels.append(
                drawing.panel(
                    f"{dof}DOF, {test_words(name)}",
                    f"DI of the heaviest payload over time, {dof}DOF, {test_words(name)}; "
                    f"over all payloads R² is {judged['observer'].r2_di:.2f} for the observer "
                    f"and {judged['lagged'].r2_di:.2f} for the lagged regressor.",
                )
            )
    mixed = any(len(study.training.phase_2_rad) > 1 for study in studies.values())
    return Figure(
        "DI without motion capture",
        "Heaviest payload of each test" + (", 2DOF at its smallest phase." if mixed else "."),
        panels,
        legend=[LegendEntry(colour, label, dash) for label, colour, dash in SOURCES.values()],
    )  # fmt: skip


def predictors_by_payload(studies: Mapping[int, StudyDocument]) -> Figure:
    """Draw the mean distance of every tip predictor by payload, on every test."""
    panels = []
    everything = [
        v
        for study in studies.values()
        for name in study.tests
        for values in _by_payload(study, name).values()
        for v in values.values()
    ]
    for dof, study in studies.items():
        for name in study.mean_euclidean_distance_m:
            lines = _by_payload(study, name)
            with Drawing() as (drawing, ax):
                for key, values in lines.items():
                    _, colour, dash = PREDICTORS[key]
                    ax.plot(
                        [float(k) for k in values], LENGTH.shown(list(values.values())),
                        color=colour, linestyle=dash, marker="o", markersize=3.5,
                    )  # fmt: skip
                ax.set(xlabel=PAYLOAD.label("payload"), ylabel=LENGTH.label("mean distance"))
                ax.set_xticks([float(k) for k in lines["rigid"]])
                log_axis(ax, LENGTH.shown(everything))
            listed = "; ".join(
                f"{PREDICTORS[key][0]} {LENGTH.number(min(v.values()))} to "
                f"{LENGTH.text(max(v.values()))}"
                for key, v in lines.items()
            )
            panels.append(
                drawing.panel(f"{dof}DOF, {test_words(name)}",
                      f"Mean distance to the measured end effector by payload: {listed}.")
            )  # fmt: skip
    degrees = ", ".join(f"{dof}DOF {study.chosen_degree}" for dof, study in studies.items())
    return Figure(
        "Tip error by predictor",
        f"Polynomials at the degree that cross-validation on trial 1 selected ({degrees}).", panels,
        legend=[LegendEntry(colour, label, dash) for label, colour, dash in PREDICTORS.values()],
    )  # fmt: skip


def _by_payload(study: StudyDocument, name: str) -> dict[str, dict[str, float]]:
    table, degree = study.mean_euclidean_distance_m[name], str(study.chosen_degree)
    baselines = study.baselines[name]
    payloads = [f"{kg:g}" for kg in study.tests[name].payload_kg]
    columns = {
        "rigid": baselines.rigid_kinematics,
        "without": {k: table[k]["without_di"][degree] for k in payloads},
        "estimated": {k: table[k]["estimated_di"][degree] for k in payloads},
        "true": {k: table[k]["with_di"][degree] for k in payloads},
        "observer": baselines.observer_tip,
    }
    return {key: {k: values[k] for k in payloads} for key, values in columns.items()}
