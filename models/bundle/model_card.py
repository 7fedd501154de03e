"""Model card of a bundle: purpose, data, accuracy and limits, from the documents in the bundle."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from firmware_py.display_units import ANGLE, DELAY, DURATION, FILE_SIZE, FRACTION, LENGTH
from firmware_py.inference.manifest import Manifest
from firmware_py.inference.predictor import TRUSTED_M
from firmware_py.signals import PERIOD_S
from models.predictor.document import CandidateEntry, Latency, PredictorsDocument, TrialsSummary
from models.predictor.guarded_tip import MARGIN
from models.predictor.validation import COVERS, MOVING_AXES, coverage_text
from models.study.document import DeployedScores, StudyDocument, read_study


def write_model_card(
    directory: Path, manifest: Manifest, predictors: PredictorsDocument | None
) -> None:
    """Write `MODEL_CARD.md` of a bundle, with its study if it has one."""
    path = directory / "study.json"
    card = model_card(manifest, predictors, read_study(path) if path.is_file() else None)
    (directory / "MODEL_CARD.md").write_text(card, encoding="utf-8", newline="\n")


def model_card(
    manifest: Manifest, predictors: PredictorsDocument | None, study: StudyDocument | None
) -> str:
    """Text of `MODEL_CARD.md`.

    `predictors`: tests of the robot's predictor; without it the robot gets the paper's polynomial.
    """
    sections = [_purpose(manifest, predictors)]
    if predictors:
        sections += [_tests(predictors), _out_of_range(predictors)]
    sections += [_data(predictors, study)]
    if study:
        sections += [_study(manifest, study), _estimation(study)]
    sections += [_limits(manifest, study)]
    if study:
        sections += [_findings(study)]
    return "\n\n".join(sections) + "\n"


def _table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _purpose(manifest: Manifest, predictors: PredictorsDocument | None) -> str:
    outside = _shares_outside(predictors)
    ranges = _table(
        ("input", "unit", "trained from", "to", *(f"outside on {test}" for test in outside)),
        [
            (
                f"`{q.name}`", q.unit, f"{q.minimum:.4g}", f"{q.maximum:.4g}",
                *(shares.get(q.name, "0 %") for shares in outside.values()),
            )
            for q in manifest.features
        ],
    )  # fmt: skip
    return f"""# End effector of a drop-stitch link, {manifest.dof}DOF

{_what(manifest, predictors)} It predicts the tip position of an inflatable link every \
{DURATION.factor * manifest.period_s:g} ms. On the robot the Deformation Index (DI) is estimated, \
not measured: the plant observer (`observer.fmu`, added by `dropstitch fmu build --unit observer`) \
drives the identified link with the measured angle and current.

It is valid for this link, its servos, its pressure and its motions. It is not a safety device: \
the robot needs safety limits of its own.

{ranges}

{_guard(predictors)} A NaN also sets `in_range` to 0. `tip_m` is in the world frame (z up, \
origin where the joint axes meet). `half_width_m` is half the width of a 95 % \
prediction interval per axis; it grows outside the training data."""


def _shares_outside(predictors: PredictorsDocument | None) -> dict[str, dict[str, str]]:
    """Share of the rows of each test with the right plant that are beyond the range of an input."""
    if predictors is None:
        return {}
    tests = predictors.candidates[predictors.chosen].tests
    return {
        test: {
            beyond.name: f"{FRACTION.number(beyond.ticks / tests[test]['all'].rows, 1)} %"
            for beyond in reasons.inputs
        }
        for test, reasons in predictors.out_of_range.items()
        if test in predictors.data
    }


def _what(manifest: Manifest, predictors: PredictorsDocument | None) -> str:
    polynomial = (
        f"the paper's polynomial of degree {manifest.degree} in the measured angles and currents "
        "and the Deformation Index (DI)"
    )
    if predictors is None:
        return f"Predictor: {polynomial}, trained on the observer's DI."
    chosen = predictors.candidates[predictors.chosen]
    return (
        f"Predictor: {chosen.summary}. Without the observer the robot falls back to {polynomial} "
        "(`polynomial.onnx`)."
    )


def _guard(predictors: PredictorsDocument | None) -> str:
    if predictors is None:
        return "Inputs outside their range are clipped to it and `in_range` becomes 0."
    mounting = (
        "The interval is that of a link mounted exactly, which no servo can check."
        if predictors.askew_rad == 0.0
        else "The interval also covers 90 % of the rows where the link is mounted askew by "
        f"{ANGLE.number(predictors.askew_rad, 2)}°, which no servo sees: with a link "
        "that is mounted right it covers more than 95 %."
    )
    return (
        f"`in_range` is 0 where a signal of joints or link leaves its range by more than "
        f"{FRACTION.number(MARGIN)} % of it, and where the interval is wider than "
        f"{LENGTH.number(TRUSTED_M)} mm to either side. Where joints move and the innovation of a "
        f"current is far above that of the training, the interval is wider by as much. {mounting}"
    )


def _tests(predictors: PredictorsDocument) -> str:
    """Tests of the chosen predictor and of those that it was compared with."""
    rows = []
    for name, entry in predictors.candidates.items():
        scores = {"left out in turn": entry.nested}
        scores |= {test: parts["all"] for test, parts in entry.tests.items()}
        label = f"**{name}**" if name == predictors.chosen else name
        rows += [
            (
                label, str(entry.variant), test, LENGTH.number(score.mean_m, 2),
                LENGTH.number(score.p95_m), LENGTH.number(score.max_m),
                coverage_text(score.coverage, score.coverage_least),
                FRACTION.number(score.in_range), LENGTH.number(score.max_in_range_m),
                *_cost(entry),
            )
            for test, score in scores.items()
        ]  # fmt: skip
    header = (
        "candidate", "variant", "test", "mean in mm", "95 % in mm", "largest in mm",
        COVERS, "in range in %", "largest in range in mm",
        "warm / cold in µs", "graph in kB",
    )  # fmt: skip
    payloads = ", ".join(f"{kg:g}" for kg in predictors.payload_kg)
    return f"""## Choice of the predictor

{predictors.reason}

Trained on {len(predictors.trials)} trials ({", ".join(predictors.motions)}; payloads {payloads} \
kg). "Left out in turn" is a nested cross-validation: each payload and each motion is left out of \
everything, the choice of the variant and the interval included. "Warm" is the median time of the \
graph in onnxruntime in a hot loop, "cold" the same every {DURATION.factor * PERIOD_S:g} ms, as on \
the robot, both on the machine that made the bundle.

{_table(header, rows)}{_runtimes(predictors)}"""


def _cost(entry: CandidateEntry) -> tuple[str, str]:
    return latency_text(entry.latency), FILE_SIZE.number(entry.graph_bytes)


def latency_text(latency: Latency) -> str:
    """Latency as "warm / cold" in µs."""
    return f"{DELAY.number(latency.warm_s)} / {DELAY.number(latency.cold_s)}"


def _runtimes(predictors: PredictorsDocument) -> str:
    if not predictors.runtimes:
        return ""
    rows = [(name, latency_text(latency)) for name, latency in predictors.runtimes.items()]
    return f"""

Observer and predictor together, by `runtime`. "compiled" is the predictor in the observer's \
library; it gives the same answers to 1e-9, which the robot checks before it moves.

{_table(("runtime", "warm / cold in µs"), rows)}"""


def _out_of_range(predictors: PredictorsDocument) -> str:
    lines = "\n".join(f"- {test}: {text}" for test, text in range_texts(predictors).items())
    return f"## Rows out of range\n\n{lines or 'There is no test.'}"


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


def _data(predictors: PredictorsDocument | None, study: StudyDocument | None) -> str:
    parts: dict[str, TrialsSummary] = {}
    if study:
        parts = {"study, trained on": study.training}
        parts |= {f"study, tested on {name}": part for name, part in study.tests.items()}
    if predictors:
        named: Mapping[str, TrialsSummary] = predictors.data
        parts |= {
            "trained on" if name == "training" else f"tested on {name}": part
            for name, part in named.items()
        }
    rows = [
        (
            role, str(len(part.trials)), "; ".join(o.words for o in part.origins) or "not stated",
            ", ".join(f"{kg:g}" for kg in part.payload_kg),
            ", ".join(f"{rad:.3f}" for rad in part.amplitude_rad), f"`{part.sha256[:12]}`",
        )
        for role, part in parts.items()
    ]  # fmt: skip
    header = ("role", "trials", "origin", "payload in kg", "amplitude in rad", "SHA-256")
    return "## Data\n\n" + _table(header, rows)


def _study(manifest: Manifest, study: StudyDocument) -> str:
    degrees = list(study.cross_validation["estimated_di"])
    rows = []
    for name, table in study.mean_euclidean_distance_m.items():
        for variant, by_degree in table["pooled"].items():
            values = [f"{LENGTH.number(by_degree[d], 2)}" for d in degrees]
            rows.append((name, variant.replace("_", " "), *values))
    validated = study.cross_validation["estimated_di"]
    rows.append(("cross-validation", "estimated di",
                 *(f"{LENGTH.number(validated[d].selection_m, 2)}" for d in degrees)))  # fmt: skip
    baselines = "; ".join(
        f"on {name} the observer's own tip {LENGTH.number(part.observer_tip['pooled'], 2)} mm, "
        f"a link that does not bend {LENGTH.number(part.rigid_kinematics['pooled'])} mm"
        for name, part in study.baselines.items()
    )
    several = validated[degrees[0]].leave_one_payload_out_m is not None
    folds = "each payload left out" if several else "five blocks of each run, with 1 s gaps"
    return f"""## Accuracy of the paper's polynomials

Mean Euclidean distance in mm over all payloads, by degree. Degree {manifest.degree} was chosen \
by cross-validation on the training trials ({folds}), without any test trial.

{_table(("test", "predictor", *degrees), rows)}

Without a polynomial: {baselines or "no test was given"}."""


def _estimation(study: StudyDocument) -> str:
    rows = []
    for name, estimators in study.estimators.items():
        for source, part in estimators.items():
            fraction = part.benefit_recovered["3"]
            shown = "no benefit" if fraction is None else f"{FRACTION.number(fraction)} %"
            rows.append((name, source, f"{part.r2_di:.3f}", shown))
    header = ("test", "DI from", "R² of DI", "fraction of true DI's benefit at degree 3")
    return "## DI without motion capture\n\n" + _table(header, rows)


def _limits(manifest: Manifest, study: StudyDocument | None) -> str:
    lines = []
    if study:
        lines += [
            f"On {name} the 95 % interval of the paper's polynomial contained the tip in "
            f"{FRACTION.number(part.interval_coverage_mean, 1)} % of the rows, mean over the axes "
            f"that move, {FRACTION.number(_worst_axis(study, part), 1)} % on the worst of them; "
            f"{FRACTION.number(part.in_range_fraction, 1)} % of the rows were in its range."
            for name, part in study.deployed.items()
        ]
        payload = study.cross_validation["estimated_di"][str(manifest.degree)]
        if payload.leave_one_payload_out_m is not None:
            lines.append(
                "Mean distance of the polynomial for a payload that is not in the training: "
                f"{LENGTH.number(payload.leave_one_payload_out_m)} mm (each payload left out in "
                "turn)."
            )
    lines += [
        "The interval is calibrated on payloads left out of training, so it is wide for the "
        "trained payloads. Coverage is lower on motions that differ from the training motion.",
        "Another pressure, temperature, link or servo needs new trials.",
    ]
    return "## Limits\n\n" + "\n".join(f"- {line}" for line in lines)


def _worst_axis(study: StudyDocument, part: DeployedScores) -> float:
    return min(part.interval_coverage["xyz"[k]] for k in MOVING_AXES[study.dof])


def _findings(study: StudyDocument) -> str:
    lines = [f"- **{f.claim}.** {f.text}" for f in study.findings]
    return "## Findings of the published study on these trials\n\n" + "\n".join(lines)
