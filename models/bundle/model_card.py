"""Model card of a bundle: purpose, data, accuracy and limits, from the documents in the bundle.

`model_card.md.jinja` is its text.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from firmware_py.core.signals import PERIOD_S
from firmware_py.core.units import ANGLE, DURATION, FILE_SIZE, FRACTION, LENGTH
from firmware_py.inference.manifest import Manifest
from firmware_py.inference.predictor import TRUSTED_M
from models.predictor.document import (
    PredictorsDocument,
    TrialsSummary,
    latency_text,
    scores_of,
)
from models.predictor.guarded_tip import MARGIN
from models.predictor.validation import COVERS, MOVING_AXES, coverage_text
from models.study.document import DeployedScores, StudyDocument, read_study


def write_model_card(
    directory: Path, manifest: Manifest, predictors: PredictorsDocument | None
) -> None:
    """Write `MODEL_CARD.md` of a bundle, with its study if it has one.

    Without `predictors` the robot gets the paper's polynomial.
    """
    path = directory / "study.json"
    study = read_study(path) if path.is_file() else None
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent), undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    environment.filters |= {
        "mm": LENGTH.number,
        "ms": lambda value_s: f"{DURATION.factor * value_s:g}",
        "degrees": ANGLE.number,
        "share": FRACTION.number,
        "kilobytes": FILE_SIZE.number,
        "latency": latency_text,
        "numbers": _numbers,
    }

    def worst_axis(scores: DeployedScores) -> float:
        return min(scores.interval_coverage["xyz"[k]] for k in MOVING_AXES[manifest.dof])

    card = environment.get_template("model_card.md.jinja").render(
        manifest=manifest, predictors=predictors, study=study, covers=COVERS, margin=MARGIN,
        chosen=predictors and predictors.candidates[predictors.chosen],
        outside=_shares_outside(predictors) if predictors else {},
        range_texts=range_texts(predictors) if predictors else {},
        data=_data(predictors, study), trusted_m=TRUSTED_M, period_s=PERIOD_S, scores=scores_of,
        coverage=coverage_text, worst_axis=worst_axis,
    )  # fmt: skip
    (directory / "MODEL_CARD.md").write_text(card, encoding="utf-8", newline="\n")


def _numbers(values: Iterable[float], form: str = "%g") -> str:
    return ", ".join(form % value for value in values)


def _shares_outside(predictors: PredictorsDocument) -> dict[str, dict[str, float]]:
    """Share of the rows of each test with the right plant that are beyond the range of an input."""
    tests = predictors.candidates[predictors.chosen].tests
    return {
        test: {beyond.name: beyond.ticks / tests[test]["all"].rows for beyond in reasons.inputs}
        for test, reasons in predictors.out_of_range.items()
        if test in predictors.data
    }


def range_texts(predictors: PredictorsDocument) -> dict[str, str]:
    """How many rows of each test are out of range, and why."""
    texts = {}
    tests = predictors.candidates[predictors.chosen].tests
    for test, reasons in predictors.out_of_range.items():
        score = tests[test]["all"]
        outside = round((1.0 - score.in_range) * score.rows)
        texts[test] = f"{outside} of {score.rows} rows are out of range"
        texts[test] += f": {reasons.note}" if reasons.note else ""
    return texts


def _data(
    predictors: PredictorsDocument | None, study: StudyDocument | None
) -> dict[str, TrialsSummary]:
    """Trials by their role."""
    parts: dict[str, TrialsSummary] = {}
    if study:
        parts = {"study, trained on": study.training}
        parts |= {f"study, tested on {name}": part for name, part in study.tests.items()}
    for name, part in predictors.data.items() if predictors else ():
        parts["trained on" if name == "training" else f"tested on {name}"] = part
    return parts
