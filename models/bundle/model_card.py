"""Model card of a bundle: purpose, data, accuracy and limits."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from firmware_py.display_units import ANGLE, DELAY, DURATION, FILE_SIZE, FRACTION, LENGTH
from firmware_py.inference.manifest import Manifest
from firmware_py.signals import PERIOD_S
from models.predictor.document import CandidateEntry, Latency, PredictorsDocument
from models.predictor.guarded_tip import MARGIN, TRUSTED_M
from models.predictor.validation import COVERS, MOVING_AXES, coverage_text
from models.study.document import DeployedScores, StudyDocument, TrialsSummary


def model_card(
    manifest: Manifest, document: StudyDocument, predictors: PredictorsDocument | None = None
) -> str:
    """Text of `MODEL_CARD.md`.

    `predictors`: comparison of the candidates; without it the robot gets the study's polynomial.
    """
    sections = (
        _purpose(manifest, predictors),
        *((_candidates(predictors),) if predictors else ()),
        _data(document),
        _figures(manifest, document),
        _estimation(document),
        _limits(manifest, document),
        _findings(document),
    )
    return "\n\n".join(sections) + "\n"


def _table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _purpose(manifest: Manifest, predictors: PredictorsDocument | None) -> str:
    ranges = _table(
        ("input", "unit", "trained from", "to"),
        [
            (f"`{q.name}`", q.unit, f"{q.minimum:.4g}", f"{q.maximum:.4g}")
            for q in manifest.features
        ],
    )
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
    return (
        f"`in_range` is 0 where a signal of joints or link leaves its range by more than "
        f"{FRACTION.number(MARGIN)} % of it, and where the interval is wider than "
        f"{LENGTH.number(TRUSTED_M)} mm to either side. Where joints move and the innovation of a "
        "current is far above that of the training, the interval is wider by as much. "
        f"{_mounting(predictors)}"
    )


def _mounting(predictors: PredictorsDocument) -> str:
    if predictors.askew_rad == 0.0:
        return "The interval is that of a link mounted exactly, which no servo can check."
    return (
        f"The interval also covers 90 % of the rows where the link is mounted askew by "
        f"{ANGLE.number(predictors.askew_rad, 2)}°, which no servo sees: with a link "
        "that is mounted right it covers more than 95 %."
    )


def _candidates(predictors: PredictorsDocument) -> str:
    """Comparison of the candidates, and the reason for the choice."""
    rows = []
    for name, entry in predictors.candidates.items():
        for test, score in (
            ("left out in turn", entry.nested),
            *((test, parts["all"]) for test, parts in entry.tests.items()),
        ):
            label = f"**{name}**" if name == predictors.chosen else name
            rows.append((
                label, str(entry.variant), test, LENGTH.number(score.mean_m, 2),
                LENGTH.number(score.p95_m), LENGTH.number(score.max_m),
                coverage_text(score.coverage, score.coverage_least),
                FRACTION.number(score.in_range),
                LENGTH.number(score.max_in_range_m), *_cost(entry),
            ))  # fmt: skip
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


def _data(document: StudyDocument) -> str:
    def line(role: str, part: TrialsSummary) -> tuple[str, ...]:
        payloads = ", ".join(f"{kg:g}" for kg in part.payload_kg)
        amplitudes = ", ".join(f"{rad:.3f}" for rad in part.amplitude_rad)
        origin = "; ".join(o.words for o in part.origins) or "not stated"
        count = str(len(part.trials))
        return role, count, origin, payloads, amplitudes, f"`{part.sha256[:12]}`"

    rows = [line("trained on", document.training)]
    rows += [line(f"tested on {name}", part) for name, part in document.tests.items()]
    header = ("role", "trials", "origin", "payload in kg", "amplitude in rad", "SHA-256")
    return "## Data\n\n" + _table(header, rows)


def _figures(manifest: Manifest, document: StudyDocument) -> str:
    degrees = list(document.cross_validation["estimated_di"])
    rows = []
    for name, table in document.mean_euclidean_distance_m.items():
        for variant, by_degree in table["pooled"].items():
            values = [f"{LENGTH.number(by_degree[d], 2)}" for d in degrees]
            rows.append((name, variant.replace("_", " "), *values))
    validated = document.cross_validation["estimated_di"]
    rows.append(("cross-validation", "estimated di",
                 *(f"{LENGTH.number(validated[d].selection_m, 2)}" for d in degrees)))  # fmt: skip
    baselines = "; ".join(
        f"on {name} the observer's own tip {LENGTH.number(part.observer_tip['pooled'], 2)} mm, "
        f"a link that does not bend {LENGTH.number(part.rigid_kinematics['pooled'])} mm"
        for name, part in document.baselines.items()
    )
    several = validated[degrees[0]].leave_one_payload_out_m is not None
    folds = "each payload left out" if several else "five blocks of each run, with 1 s gaps"
    return f"""## Accuracy

Mean Euclidean distance in mm over all payloads, by degree. Degree {manifest.degree} was chosen \
by cross-validation on the training trials ({folds}), without any test trial.

{_table(("test", "predictor", *degrees), rows)}

Without a polynomial: {baselines or "no test was given"}."""


def _estimation(document: StudyDocument) -> str:
    rows = []
    for name, estimators in document.estimators.items():
        for source, part in estimators.items():
            fraction = part.benefit_recovered["3"]
            shown = "no benefit" if fraction is None else f"{FRACTION.number(fraction)} %"
            rows.append((name, source, f"{part.r2_di:.3f}", shown))
    header = ("test", "DI from", "R² of DI", "fraction of true DI's benefit at degree 3")
    return "## DI without motion capture\n\n" + _table(header, rows)


def _limits(manifest: Manifest, document: StudyDocument) -> str:
    coverage = "\n".join(
        f"- On {name} the 95 % interval contained the tip in "
        f"{FRACTION.number(part.interval_coverage_mean, 1)} % of the rows, mean over the axes that "
        f"move, {FRACTION.number(_worst_axis(document, part), 1)} % on the worst of them; "
        f"{FRACTION.number(part.in_range_fraction, 1)} % of the rows were in range."
        for name, part in document.deployed.items()
    )
    validated = document.cross_validation["estimated_di"][str(manifest.degree)]
    payload = validated.leave_one_payload_out_m
    unseen = (
        f"\n- Mean distance for a payload that is not in the training: {LENGTH.number(payload)} mm "
        "(each payload left out in turn)."
        if payload is not None
        else ""
    )
    return f"""## Limits

{coverage}{unseen}
- The interval is calibrated on payloads left out of training, so it is wide for the trained \
payloads. Coverage is lower on motions that differ from the training motion.
- Another pressure, temperature, link or servo needs new trials."""


def _worst_axis(document: StudyDocument, part: DeployedScores) -> float:
    return min(part.interval_coverage["xyz"[k]] for k in MOVING_AXES[document.dof])


def _findings(document: StudyDocument) -> str:
    lines = [f"- **{f.claim}.** {f.text}" for f in document.findings]
    return "## Findings of the published study on these trials\n\n" + "\n".join(lines)
