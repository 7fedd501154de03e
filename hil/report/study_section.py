"""Section about the study: predictors and estimators of the tip, motion and errors, the paper.

Only the paper's link is compared with the paper. A study of another link has the same figures
without it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Final

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from firmware_py.core.units import (
    ANGLE,
    DEFORMATION,
    LENGTH,
    PAYLOAD,
    TIME,
    DisplayUnit,
)
from hil.report.build_inputs import ALL_PHASES, BuildInputs, motion_words
from models.shared.drawing import Chart, Line, line_panels
from models.shared.pages import (
    Cell,
    Figure,
    Folded,
    LegendEntry,
    Panel,
    Paragraph,
    Part,
    Table,
)
from models.shared.palette import AMBER, BLUE, GREEN, INK, MUTED, SERIES, ordered_colours
from models.study.document import StudyDocument
from models.trials.origin import TrialOrigin, merged_origins

Array = NDArray[np.float64]
Studies = Mapping[str, StudyDocument]
"""Studies by their label, such as "2DOF, phase 0°"."""

PLANES: Final = {"x–z plane": ("x", "z"), "from above": ("x", "y")}
"""Axes of each view of the tip."""
TEST: Final = "trial_2"
BY_DEGREE: Final = "Mean Euclidean distance in mm on trial 2 by degree"
Look = tuple[str, str, str]
"""Label, colour and dash of a line."""
VARIANTS: Final[dict[str, Look]] = {
    "with_di": ("true DI", BLUE, "solid"),
    "estimated_di": ("estimated DI (robot)", BLUE, "dashed"),
    "without_di": ("without DI", BLUE, "dotted"),
}
FOLDS: Final[dict[str, Look]] = {
    "trial_2": ("trial 2", BLUE, "solid"),
    "leave_one_payload_out_m": ("payloads left out of trial 1", INK, "dashed"),
    "blocks_m": ("blocks of time left out of trial 1", INK, "dotted"),
}
SOURCES: Final[dict[str, Look]] = {
    "true": ("motion capture", INK, "solid"),
    "observer": ("plant observer", BLUE, "dashed"),
    "lagged": ("lagged regressor", AMBER, "dotted"),
}
PREDICTORS: Final[dict[str, Look]] = {
    "rigid": ("rigid kinematics", MUTED, "solid"),
    "without": ("polynomial without DI", AMBER, "dotted"),
    "estimated": ("polynomial, estimated DI (robot)", BLUE, "solid"),
    "true": ("polynomial, true DI", INK, "dashed"),
    "observer": ("tip of the plant observer", GREEN, "solid"),
}


VERDICTS: Final = {True: "as published", False: "differs", None: "undecided"}
"""Comparison of a finding with the paper."""


def study_parts(inputs: BuildInputs) -> list[Part]:
    """Predictors and estimators, motion and errors, and the paper for the paper's link."""
    studies, robot = inputs.studies, inputs.robot_studies
    if not studies:
        return []
    return [
        Paragraph(
            "On the robot DI is not measured. The plant observer estimates it from angle and "
            "current. It is compared with a lagged regressor and with no DI, on trial 2 and on a "
            "motion that neither training nor identification used."
        ),
        predictors_by_payload(robot),
        di_estimates(robot),
        *motion_figures(_of_one_motion(studies)),
        *error_figures(studies),
        Paragraph(
            "The model card (MODEL_CARD.md) of each bundle has the numbers: errors of the "
            "predictors by degree, estimators of DI, and candidates for the robot's predictor.",
            "note",
        ),
        *comparison_with_paper(studies),
    ]


def study_origins(study: StudyDocument) -> tuple[TrialOrigin, ...]:
    parts = (study.training, *study.tests.values())
    return merged_origins(origin for part in parts for origin in part.origins)


def _of_one_motion(studies: Studies) -> Studies:
    """Studies of a single kind of motion; that of all phases only if 2DOF has no other."""
    single = {name: study for name, study in studies.items() if name != ALL_PHASES}
    return single if any(study.dof == 2 for study in single.values()) else studies


def comparison_with_paper(studies: Studies) -> list[Part]:
    """What the paper's authors report of their link, beside these trials; a link of your own has
    no findings, so no comparison.
    """
    rows: dict[str, list[str]] = {}
    for name, study in studies.items():
        for finding in study.findings:
            _, _, measured = finding.text.partition(": ")  # after the verdict
            measured = (measured or finding.text).replace("trial_2", "trial 2")
            words = f"{name}: {VERDICTS[finding.holds]}; {measured}"
            rows.setdefault(finding.claim, []).append(words)
    if not rows:
        return []
    cells: list[list[Cell]] = [[c, Markup("<br>").join(words)] for c, words in rows.items()]
    note = (
        "No parameter was tuned to the paper. Above are paths (its Fig. 7), DI over the angle "
        "(9, 10) and by payload (11), errors over time (12, 13), over the degree (14) and by DI "
        "(15). It does not state the phase by which joint 2 leads joint 1, so each "
        "phase has a study."
    )
    table = Table("", ["the paper reports", "these trials"], cells, note)
    return [Folded("Comparison with the paper", [table])]


def _ordered_legend(labels: Iterable[str]) -> list[LegendEntry]:
    labels = list(labels)
    colours = ordered_colours(len(labels))
    return [LegendEntry(colour, label) for colour, label in zip(colours, labels, strict=True)]


def _payload_legend(studies: Studies) -> list[LegendEntry]:
    """Legend of the runs of a study: "0.5 kg", "2 kg, phase 90°"."""
    labels = []
    for key in next(iter(studies.values())).series.path:
        payload, _, phase = key.partition(" phase ")
        labels.append(f"{payload} kg" + (f", phase {phase.removesuffix('deg')}°" if phase else ""))
    return _ordered_legend(labels)


# --- motion of the link -------------------------------------------------------------------------


def motion_figures(studies: Studies) -> list[Figure]:
    """Paths and DI, with a panel for each kind of motion."""
    return [_paths(studies), _di_over_angle(studies), _mean_di(studies)]


def _paths(studies: Studies) -> Figure:
    panels: list[Panel] = []
    for motion, study in studies.items():
        paths = study.series.path.values()
        colours = ordered_colours(len(paths))
        # Where the paths coincide, each is thinner than the one beneath.
        widths = [1.1 + 0.8 * k for k in reversed(range(len(paths)))]
        for plane, (h, v) in [*PLANES.items()][: study.dof]:
            lines = [
                Line(getattr(path, f"tip_{h}_m"), getattr(path, f"tip_{v}_m"), colour, width=width)
                for path, colour, width in zip(paths, colours, widths, strict=True)
            ]
            alt = f"Path of the end effector, {motion}, {plane}, one line per payload."
            panels += line_panels(
                [Chart(f"{motion}, {plane}", alt, lines)], f"{h} in m", f"{v} in m",
                aspect="equal", adjustable="datalim",
            )  # fmt: skip
    return Figure(
        "Paths of the end effector",
        "The base joint is at the origin; at angle zero the link is along z. The lines get thinner "
        "from the lightest payload to the heaviest.",
        panels, legend=_payload_legend(studies),
    )  # fmt: skip


def _di_over_angle(studies: Studies) -> Figure:
    charts = []
    for motion, study in studies.items():
        curves = [(c.angle_1_rad, c.di) for c in study.series.di.values()]
        alt = f"DI over the angle of joint 1, {motion}, one loop per payload."
        charts.append(_curves(motion, alt, curves, ANGLE, DEFORMATION))
    return Figure(
        "DI over the angle", "Trial 1. Marker noise alone contributes about 0.07 %.",
        line_panels(charts, ANGLE.label("angle 1"), DEFORMATION.label("DI"), ylim=(0, None)),
        legend=_payload_legend(studies),
    )  # fmt: skip


def _curves(
    title: str,
    alt: str,
    curves: Sequence[tuple[Sequence[float], Sequence[float]]],
    x: DisplayUnit,
    y: DisplayUnit,
) -> Chart:
    """Thin lines of an ordered quantity."""
    lines = [
        Line(x.shown(xs), y.shown(ys), colour, width=1.0)
        for (xs, ys), colour in zip(curves, ordered_colours(len(curves)), strict=True)
    ]
    return Chart(title, alt, lines)


def _mean_di(studies: Studies) -> Figure:
    lines, legend, listed = [], [], []
    for (motion, study), colour in zip(studies.items(), SERIES, strict=False):
        payloads_kg = [float(kg) for kg in study.mean_di]
        values = DEFORMATION.shown([*study.mean_di.values()])
        lines.append(Line(payloads_kg, values, colour, marker="o"))
        legend.append(LegendEntry(colour, motion))
        listed.append(f"{motion}: " + ", ".join(map(DEFORMATION.text, study.mean_di.values())))
    alt = f"Mean DI over payload. {'; '.join(listed)}."
    panels = line_panels(
        [Chart("All motions", alt, lines)], PAYLOAD.label("payload"), DEFORMATION.label("mean DI"),
        ylim=(0, None), xticks=payloads_kg,
    )  # fmt: skip
    return Figure("Mean DI by payload", "Rows of trial 1 in motion.", panels, legend=legend)


# --- errors of the polynomials ------------------------------------------------------------------


def error_figures(studies: Studies) -> list[Figure]:
    """Errors over time, over the degree and by DI, a panel for each study with a trial 2."""
    tested = {name: study for name, study in studies.items() if TEST in study.tests}
    if not tested:
        return []
    return [_error_over_time(tested), _error_over_degree(tested), _gain_by_di(tested)]


def _error_over_time(studies: Studies) -> Figure:
    charts = []
    for name, study in studies.items():
        error = study.series.error[TEST]
        curves = [(error.time_s, curve) for curve in error.euclidean_distance_m.values()]
        alt = f"Euclidean distance over time, {name}, mean over payloads, a line for each degree."
        charts.append(_curves(name, alt, curves, TIME, LENGTH))
    degrees = next(iter(studies.values())).series.error[TEST].euclidean_distance_m
    return Figure(
        "Error of the predictors over time",
        "With true DI; trained on trial 1, tested on trial 2, mean over the payloads.",
        line_panels(charts, TIME.label("time"), LENGTH.label("distance"), log=True),
        legend=_ordered_legend(f"degree {d}" for d in degrees),
    )


def _error_over_degree(studies: Studies) -> Figure:
    charts = []
    for name, study in studies.items():
        curves = {"trial_2": _pooled(study, "with_di")}
        for kind in ("leave_one_payload_out_m", "blocks_m"):
            folds = [getattr(f, kind) for f in study.cross_validation["with_di"].values()]
            if None not in folds:
                curves[kind] = LENGTH.shown(folds)
        degrees = range(1, len(curves["trial_2"]) + 1)
        charts.append(_compared(name, BY_DEGREE, degrees, curves, FOLDS))
    return Figure(
        "Error over the degree",
        "With true DI, pooled over payloads. The degree is chosen by payloads left out of trial "
        "1, never by trial 2.",
        line_panels(charts, "degree", LENGTH.label("mean distance"), log=True),
        legend=_legend(FOLDS),
    )


def _gain_by_di(studies: Studies) -> Figure:
    charts = []
    for name, study in studies.items():
        distances = {variant: _pooled(study, variant) for variant in VARIANTS}
        degrees = range(1, len(distances["with_di"]) + 1)
        charts.append(_compared(name, BY_DEGREE, degrees, distances, VARIANTS))
    return Figure(
        "Accuracy gained by DI",
        "Trained on trial 1, tested on trial 2. The robot has no motion capture: it uses the "
        "predictor that was trained on estimated DI.",
        line_panels(charts, "degree", LENGTH.label("mean distance"), log=True),
        legend=_legend(VARIANTS),
    )


def _compared(
    title: str, about: str, x: Sequence[float], curves: Mapping[str, Array],
    looks: Mapping[str, Look], marker: str = "o",
) -> Chart:  # fmt: skip
    """Chart of several curves over the same x; `looks` by the curves' keys."""
    lines = [Line(x, y, *looks[key][1:], marker=marker) for key, y in curves.items()]
    means = "; ".join(
        f"{looks[key][0]} {np.nanmean(y):.2g} on average" for key, y in curves.items()
    )
    return Chart(title, f"{about}, {title}: {means}.", lines)


def _legend(looks: Mapping[str, Look]) -> list[LegendEntry]:
    return [LegendEntry(colour, label, dash) for label, colour, dash in looks.values()]


def _pooled(study: StudyDocument, variant: str) -> Array:
    """Mean distance over all payloads by degree, in the display unit."""
    return LENGTH.shown([*study.mean_euclidean_distance_m[TEST]["pooled"][variant].values()])


# --- predictors and estimators without motion capture -------------------------------------------


def di_estimates(studies: Mapping[int, StudyDocument]) -> Figure:
    """DI of the heaviest payload over time, by source, on every test."""
    charts = []
    for dof, study in studies.items():
        for test, curves in study.series.estimates.items():
            di = {source: DEFORMATION.shown(getattr(curves, source)) for source in SOURCES}
            title = f"{dof}DOF, {motion_words(test)}"
            charts.append(_compared(title, "DI in % over time", curves.time_s, di, SOURCES, ""))
    mixed = any(len(study.training.phase_2_rad) > 1 for study in studies.values())
    return Figure(
        "DI without motion capture",
        "Heaviest payload of each test" + (", 2DOF at its smallest phase." if mixed else "."),
        line_panels(charts, TIME.label("time"), DEFORMATION.label("DI"), ylim=(0, None)),
        legend=_legend(SOURCES),
    )


def predictors_by_payload(studies: Mapping[int, StudyDocument]) -> Figure:
    """Mean distance of every tip predictor by payload, on every test."""
    charts, payloads_kg = [], list[float]()
    for dof, study in studies.items():
        for test, of_test in study.tests.items():
            payloads_kg = list(of_test.payload_kg)
            distances = {
                key: LENGTH.shown([by_payload[f"{kg:g}"] for kg in payloads_kg])
                for key, by_payload in _by_payload(study, test).items()
            }
            title = f"{dof}DOF, {motion_words(test)}"
            about = "Mean distance in mm to the measured tip by payload"
            charts.append(_compared(title, about, payloads_kg, distances, PREDICTORS))
    degrees = ", ".join(f"{dof}DOF {study.chosen_degree}" for dof, study in studies.items())
    return Figure(
        "Tip error by predictor",
        f"Polynomials at the degree that cross-validation on trial 1 selected ({degrees}).",
        line_panels(
            charts, PAYLOAD.label("payload"), LENGTH.label("mean distance"), log=True,
            xticks=payloads_kg,
        ),
        legend=_legend(PREDICTORS),
    )  # fmt: skip


def _by_payload(study: StudyDocument, test: str) -> dict[str, dict[str, float]]:
    """Mean distance of each predictor by payload in kg, and over all of them ("pooled")."""
    table, degree = study.mean_euclidean_distance_m[test], str(study.chosen_degree)
    return {
        "rigid": study.baselines[test].rigid_kinematics,
        "without": {part: variants["without_di"][degree] for part, variants in table.items()},
        "estimated": {part: variants["estimated_di"][degree] for part, variants in table.items()},
        "true": {part: variants["with_di"][degree] for part, variants in table.items()},
        "observer": study.baselines[test].observer_tip,
    }
