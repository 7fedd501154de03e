"""Tables of the report: results and targets, predictors, plant, FMUs, prediction error."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from firmware_py.core.units import (
    DEFORMATION,
    FRACTION,
    LENGTH,
    TICK_TIME,
    error_unit,
    signal_words,
    symbol_of,
)
from firmware_py.system.targets import (
    DI_GAIN_DEGREE,
    DI_GAIN_FRACTION,
    FMU_PARITY,
    PLANT_TIP_RMS_M,
)
from hil.report.build_inputs import BuildInputs, FmuCheckOutput, LoopRun
from hil.report.study.estimator_figures import test_words
from hil.sil.timing_document import TipErrors
from models.plant.document import DofEvaluation, Evaluation, SignalError, TipError
from models.plant.plant import Plant
from models.predictor.validation import COVERS, coverage_text
from models.shared.pages import NO_VALUE, Cell, Table, TableCell
from models.study.document import StudyDocument

DOFS: Final = (1, 2)
DEFAULT_RIG: Final = ("rig", "default")
_PARTS: Final = {
    "all": "all ticks", "in_range": "in range",
    "out_of_range": "out of range",
    "rest": "rest between motions", "motion": "motion, as in training",
    "glide": "glide to zero after the motion", "stop": "controlled stop",
}  # fmt: skip


def _at_most(value: float | None, limit: float, text: str) -> TableCell:
    """Cell with a text, marked by whether the value is within the limit."""
    return TableCell(NO_VALUE) if value is None else TableCell(text, value <= limit)


def _power(value: float, decimals: int) -> str:
    """Format a small number like "1e-9", without zeros in the exponent."""
    mantissa, exponent = f"{value:.{decimals}e}".split("e")
    return f"{mantissa}e{int(exponent)}"


def results_table(inputs: BuildInputs) -> Table:
    """Return the results with their targets; a missing measurement is not judged."""
    rows: list[list[Cell]] = []
    for title in inputs.evaluations or ("trials",):
        limits = _tip_limits_m(inputs, title)
        told = "\u00a0/\u00a0".join(LENGTH.number(limit) for limit in limits.values())
        row: list[Cell] = [
            f"Tip error (RMS) of the identified plant, {title}",
            f"≤\u00a0{told}\u00a0{LENGTH.name}" if told else NO_VALUE,
        ]
        for dof in DOFS:
            error_m = _tip_rms_m(inputs, title, dof)
            text = LENGTH.text(error_m) if error_m is not None else ""
            limit_m = limits.get(dof)
            row.append(_at_most(error_m, limit_m, text) if limit_m else text or NO_VALUE)
        rows.append(row)
    for test, limit in DI_GAIN_FRACTION.items():
        row = [
            f"Fraction of true DI's gain recovered by estimated DI, degree {DI_GAIN_DEGREE}, "
            f"{test_words(test)}",
            f"≥\u00a0{FRACTION.text(limit)}",
        ]
        for dof in DOFS:
            gain = _benefit(inputs.studies.get(dof), test)
            row.append(NO_VALUE if gain is None else TableCell(FRACTION.text(gain), gain >= limit))
        rows.append(row)
    rows.append(["Largest difference of the twin FMU from the Python plant, SI units",
                 f"≤\u00a0{_power(FMU_PARITY, 0)}"])  # fmt: skip
    for dof in DOFS:
        parity = _parity(inputs.checks.get(f"twin_{dof}dof"))
        rows[-1].append(_at_most(parity, FMU_PARITY, _power(parity, 0) if parity else "0"))
    loops = {dof: _real_time_loop(inputs, dof) for dof in DOFS}
    rows.append(["Own cost of a tick, p99 (depends on the machine, not judged)", NO_VALUE])
    for loop in loops.values():
        cost_ns = loop.timing.own_cost.p99_ns if loop else None
        rows[-1].append(TICK_TIME.text(cost_ns, 2) if cost_ns is not None else NO_VALUE)
    rows.append(["Deadlines missed by the loop itself", "0"])
    for loop in loops.values():
        misses = loop.timing.own_misses if loop else None
        rows[-1].append(_at_most(misses, 0, str(misses)))
    return Table("", ["", "target", "1DOF", "2DOF"], rows)


def _tip_limits_m(inputs: BuildInputs, title: str) -> Mapping[int, float]:
    """Targets for the tip error, which exist only for trials of the default rig."""
    evaluation = inputs.evaluations.get(title)
    if evaluation is None or {(o.source, o.rig) for o in evaluation.origins} != {DEFAULT_RIG}:
        return {}
    return PLANT_TIP_RMS_M.get(title, {})


def _tip_rms_m(inputs: BuildInputs, title: str, dof: int) -> float | None:
    evaluation = inputs.evaluations.get(title)
    part = evaluation.dof.get(str(dof)) if evaluation else None
    return part.tip_rms_m if part else None


def _benefit(study: StudyDocument | None, test: str) -> float | None:
    if study is None or test not in study.estimators:
        return None
    return study.estimators[test]["observer"].benefit_recovered[DI_GAIN_DEGREE]


def _parity(check: FmuCheckOutput | None) -> float | None:
    return max(check.parity.values(), default=None) if check else None


def _real_time_loop(inputs: BuildInputs, dof: int) -> LoopRun | None:
    """Run in real time of a dof; a run on the virtual line measures no cost."""
    return next((loop for loop in inputs.loops if loop.dof == dof and loop.in_real_time), None)


def predictor_table(studies: Mapping[str, StudyDocument]) -> Table:
    """Return the mean distance over payloads at the chosen degree, also by phase if they differ."""
    rows = []
    for name, study in studies.items():
        degree = str(study.chosen_degree)
        for test, table in study.mean_euclidean_distance_m.items():
            base = study.baselines[test]
            covered = study.deployed[test].interval_coverage_by_part
            for part in ("pooled", *(key for key in table if key.startswith("phase_"))):
                phase = f", phase {part[6:-3]}° of it" if part != "pooled" else ""
                distances_m = (
                    base.rigid_kinematics[part], table[part]["without_di"][degree],
                    table[part]["estimated_di"][degree], table[part]["with_di"][degree],
                    base.observer_tip[part],
                )  # fmt: skip
                rows.append(
                    [
                        f"{name}, {test_words(test)}{phase}", degree,
                        *map(LENGTH.number, distances_m), FRACTION.text(covered[part], 1),
                    ]
                )  # fmt: skip
    return Table(
        f"Mean Euclidean distance in {LENGTH.name}, all payloads",
        ["", "degree", "rigid link", "without DI", "estimated DI", "true DI", "observer's tip",
         "interval covers"],
        rows,
        "The interval is the predictor's 95\u00a0% prediction interval; what it covers is the mean "
        "over the axes that move. It is "
        "calibrated on payloads left out of training, so its coverage of the training payloads "
        "is higher.",
    )  # fmt: skip


def di_estimator_table(studies: Mapping[int, StudyDocument]) -> Table:
    """Return the accuracy of the three estimators of DI on every test."""
    rows = []
    for dof, study in studies.items():
        for test, by_source in study.estimators.items():
            for source, scores in by_source.items():
                gain = scores.benefit_recovered[DI_GAIN_DEGREE]
                rows.append(
                    [
                        f"{dof}DOF, {test_words(test)}", source,
                        f"{scores.r2_di:.2f}".replace("-", "−"),
                        DEFORMATION.number(scores.rms_error_di, 3),
                        LENGTH.number(scores.mean_euclidean_distance_m[DI_GAIN_DEGREE]),
                        NO_VALUE if gain is None else FRACTION.text(gain).replace("-", "−"),
                    ]
                )  # fmt: skip
    return Table(
        "Estimators of DI",
        ["", "estimator", "R² of DI", f"RMS error of DI, {DEFORMATION.name}",
         f"distance at degree {DI_GAIN_DEGREE}, {LENGTH.name}", "gain recovered"],
        rows,
        "Gain: reduction of the mean Euclidean distance by true DI, compared with no DI. Each "
        "predictor was trained on the DI of its own estimator, on trial 1.",
    )  # fmt: skip


def evaluation_table(evaluations: Mapping[str, Evaluation]) -> Table:
    """Return the errors of the identified plant by signal, with rigid kinematics as baseline."""
    parts = {
        f"{title}, {dof}DOF": part
        for title, evaluation in evaluations.items()
        for dof, part in evaluation.dof.items()
    }
    names = sorted({name for part in parts.values() for name in part.signals})
    rows = [
        [signal_words(name), *(_signal_error(part.signals.get(name)) for part in parts.values())]
        for name in names
    ]
    rows.append(["tip, all axes", *map(_beside_rigid, parts.values())])
    for kg in dict.fromkeys(kg for part in parts.values() for kg in part.payloads):
        rows.append([f"tip at {kg} kg", *(_of_payload(part, kg) for part in parts.values())])
    return Table(
        "Identified plant on trials that it was not fitted to",
        ["", *parts],
        rows,
        "Signals: RMS error, in brackets the mean absolute error. Tip: RMS error, in brackets that "
        "of rigid kinematics, which is a link that does not bend at the measured angles.",
    )


def _signal_error(error: SignalError | None) -> str:
    if error is None:
        return NO_VALUE
    unit = error_unit(error.unit)
    return f"{unit.significant(error.rms)} ({unit.factor * error.mae:.3g})"


def _of_payload(part: DofEvaluation, payload_kg: str) -> str:
    error = part.payloads.get(payload_kg)
    return _beside_rigid(error) if error else NO_VALUE


def _beside_rigid(error: TipError) -> str:
    if error.tip_rms_m is None or error.rigid_tip_rms_m is None:
        return NO_VALUE
    return f"{LENGTH.text(error.tip_rms_m)} ({LENGTH.number(error.rigid_tip_rms_m)})"


def parameter_table(plant: Plant) -> Table | None:
    """Return the identified parameters with standard errors; None if nothing was fitted."""
    rows = []
    for name in plant.provenance.fitted_parameters:
        if (row := plant.parameters.get(name)) is None:
            continue
        error = NO_VALUE if row.error is None else f"{row.error:.2g}"
        rows.append([name, f"{row.value:.4g}".replace("-", "−"), error, symbol_of(row.unit)])
    header = ["", "value", "standard error", "unit"]
    return Table("Identified parameters", header, rows) if rows else None


def fmu_tables(checks: Mapping[str, FmuCheckOutput]) -> list[Table]:
    """Return the checks of every FMU, and the parity of every output."""
    kinds = dict.fromkeys(c.name for check in checks.values() for c in check.checks)
    rows: list[list[Cell]] = []
    for kind in kinds:
        rows.append([kind])
        for check in checks.values():
            results = [c for c in check.checks if c.name == kind]
            text = "; ".join(dict.fromkeys(c.detail for c in results))
            passed = all(c.passed for c in results)
            rows[-1].append(TableCell(text, passed) if results else NO_VALUE)
    outputs = list(dict.fromkeys(o for check in checks.values() for o in check.parity))
    differing = [o for o in outputs if any(c.parity.get(o) for c in checks.values())]
    parity: list[list[Cell]] = []
    for output in differing:
        parity.append([output])
        for check in checks.values():
            value = check.parity.get(output)
            text = _power(value, 1) if value else "0"
            parity[-1].append(_at_most(value, check.parity_limit, text))
    equal = (
        f"{len(outputs) - len(differing)} of {len(outputs)} outputs are equal to the last bit, "
        "over fixed and varying steps of the study's motion."
    )
    tables = [Table("Checks", ["", *checks], rows, "" if parity or not outputs else equal)]
    if parity:
        title = "Largest difference from the interpreted model"
        tables.append(Table(title, ["output", *checks], parity, equal))
    return tables


def verdict_sentence(loop: LoopRun) -> str:
    """Return the result of a run as text."""
    timing = loop.timing
    if not loop.in_real_time:
        return (
            "On the virtual line the clock is simulated: computation takes no time and a run can "
            "be repeated bit by bit. Durations contain bus time only."
        )
    causes = ", ".join(f"{count} {cause.value}" for cause, count in timing.causes.items() if count)
    lost = (
        f" {timing.misses} of {timing.slots} slots were missed ({causes}; longest run of "
        f"misses {timing.longest_run_of_misses})."
        if causes
        else ""
    )
    bound = FRACTION.text(timing.own_miss_rate_upper_bound_95, 2)
    return (
        f"Verdict: {timing.verdict}; {timing.reason}.{lost} With 95\u00a0% confidence the "
        f"loop itself misses less than {bound} of the deadlines."
    )


def prediction_table(loop: LoopRun) -> Table | None:
    """Return the prediction error by part of the run; None if the true tip is unknown."""
    error = loop.timing.prediction_error
    rows = [
        [
            _PARTS.get(name, name), str(part.n),
            *(LENGTH.number(distance_m) for distance_m in distances_m),
            coverage_text(part.interval_coverage or 0.0, part.interval_coverage_least or 0.0),
            FRACTION.text(part.in_range_fraction or 0.0, 1),
        ]
        for name, part in {"all": error, **error.parts}.items()
        if (distances_m := _distances_m(part))
    ]  # fmt: skip
    if not rows:
        return None
    return Table(
        f"Distance between predicted and true tip in {LENGTH.name}",
        ["", "ticks", "mean", "95th percentile", "maximum", COVERS, "in range"],
        rows,
        "During glide and rest the link still swings while the joints hardly move. The paper's "
        "polynomial cannot tell to which side: angle, current and DI, which has no sign, do not "
        "show it. The observer's bend does. Where the coverage is below 95\u00a0% the interval is "
        "too narrow.",
    )


def _distances_m(part: TipErrors) -> tuple[float, float, float] | None:
    """Mean, 95th percentile and maximum; None if there was no fresh tick."""
    if part.mean_euclidean_distance_m is None or part.p95_m is None or part.max_m is None:
        return None
    return part.mean_euclidean_distance_m, part.p95_m, part.max_m
