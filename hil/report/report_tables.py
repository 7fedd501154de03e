"""Tables of the report: figures against their targets, estimators, plant, units, timing."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from firmware_py.signals import unit_of
from hil.report.build_inputs import Inputs, Json, LoopRun
from hil.report.study.estimator_figures import test_title

MM: Final = 1e3
TIP_RMS_LIMIT_M: Final = {1: 6e-3, 2: 9e-3}
BENEFIT_LIMIT: Final = {"trial_2": 0.9, "unseen_20deg": 0.8}
BENEFIT_DEGREE: Final = "3"
NO_VALUE: Final = "–"
_PARTS: Final = {
    "all": "all ticks", "in_range": "inputs in the training range", "out_of_range": "outside it",
    "rest": "rest between motions", "motion": "motion, as in training",
    "glide": "glide to zero after it", "stop": "controlled stop",
}  # fmt: skip
_READABLE: Final = {"rad": ("mrad", 1e3), "m": ("mm", 1e3), "1": ("%", 1e2)}
"""SI unit to the one in which an error is shown, and the factor."""


@dataclass(frozen=True)
class TableCell:
    """Text of a cell, and whether it meets its target (None: there is none)."""

    text: str
    met: bool | None = None


@dataclass(frozen=True)
class Table:
    """Header, rows (each starts with what the row is about) and a sentence below."""

    title: str
    header: list[str]
    rows: list[list[TableCell]]
    note: str = ""
    missing: list[str] = field(default_factory=list)


def percent(share: float, digits: int = 0) -> str:
    """A share in percent, with the space that SI asks for."""
    return f"{100 * share:.{digits}f}\u00a0%"


def _row(*cells: str | TableCell) -> list[TableCell]:
    return [cell if isinstance(cell, TableCell) else TableCell(cell) for cell in cells]


def _judged(value: float | None, limit: float, text: str) -> TableCell:
    if value is None:
        return TableCell(NO_VALUE)
    return TableCell(text.format(value) if value else "0", value <= limit)


def at_a_glance(inputs: Inputs) -> Table:
    """What was asked for beside what was measured."""
    dofs = (1, 2)
    rows = []
    limits = "\u00a0/\u00a0".join(f"{MM * TIP_RMS_LIMIT_M[dof]:.0f}" for dof in dofs)
    for title in inputs.evaluations or ("trials",):
        errors = [_tip_mm(inputs, title, dof) for dof in dofs]
        rows.append(
            _row(
                f"Identified plant, tip error RMS, {title}",
                f"≤\u00a0{limits}\u00a0mm",
                *(
                    _judged(error, MM * TIP_RMS_LIMIT_M[dof], "{:.1f}\u00a0mm")
                    for dof, error in zip(dofs, errors, strict=True)
                ),
            )
        )
    for test, limit in BENEFIT_LIMIT.items():
        shares = [_benefit(inputs.studies.get(dof), test) for dof in dofs]
        rows.append(
            _row(
                f"Estimated DI, share of true DI's gain at degree {BENEFIT_DEGREE}, "
                f"{test_title(test)}",
                f"≥\u00a0{percent(limit)}",
                *(
                    TableCell(NO_VALUE)
                    if share is None
                    else TableCell(percent(share), share >= limit)
                    for share in shares
                ),
            )
        )
    worst = {dof: _parity(inputs.checks.get(f"twin_{dof}dof")) for dof in dofs}
    rows.append(
        _row("Twin unit against the Python plant", "≤\u00a01e-9",
             *(_judged(worst[dof], 1e-9, "{:.0e}") for dof in dofs))
    )  # fmt: skip
    loops = {dof: _loop_of(inputs, dof) for dof in dofs}
    cost = {dof: loop.timing["own_cost"]["p99_ns"] / 1e6 if loop else None
            for dof, loop in loops.items()}  # fmt: skip
    rows.append(
        _row(
            "Tick, own cost p99",
            "≤\u00a01.5\u00a0ms",
            *(_judged(cost[d], 1.5, "{:.2f}\u00a0ms") for d in dofs),
        )
    )
    own = {dof: loop.timing["own_misses"] if loop else None for dof, loop in loops.items()}
    rows.append(
        _row("Deadlines missed by our own doing", "0", *(_judged(own[d], 0, "{:d}") for d in dofs))
    )
    return Table("", ["", "target", "1DOF", "2DOF"], rows)


def _tip_mm(inputs: Inputs, title: str, dof: int) -> float | None:
    part = inputs.evaluations.get(title, {}).get("dof", {}).get(str(dof), {})
    return None if part.get("tip_rms_m") is None else MM * part["tip_rms_m"]


def _benefit(study: Json | None, test: str) -> float | None:
    if study is None or test not in study["estimators"]:
        return None
    return float(study["estimators"][test]["observer"]["benefit_recovered"][BENEFIT_DEGREE])


def _parity(check: Json | None) -> float | None:
    return max(check["parity"].values(), default=None) if check else None


def _loop_of(inputs: Inputs, dof: int) -> LoopRun | None:
    """The run in real time that belongs to a dof; a simulated one says nothing about cost."""
    return next((loop for loop in inputs.loops if loop.dof == dof and loop.in_real_time), None)


def predictors(studies: dict[str, Json]) -> Table:
    """Mean Euclidean distance at the chosen degree, over payloads; by phase where there are two."""
    rows = []
    for name, study in studies.items():
        degree = str(study["chosen_degree"])
        for test, table in study["mean_euclidean_distance_m"].items():
            base = study["baselines"][test]
            covered = study["deployed"][test]["interval_coverage_by_part"]
            for part in ("pooled", *(key for key in table if key.startswith("phase_"))):
                phase = f", phase {part[6:-3]}° of it" if part != "pooled" else ""
                rows.append(
                    _row(
                        f"{name}, {test_title(test)}{phase}", degree,
                        *(f"{MM * v:.1f}" for v in (
                            base["rigid_kinematics"][part], table[part]["without_di"][degree],
                            table[part]["estimated_di"][degree], table[part]["with_di"][degree],
                            base["observer_tip"][part],
                        )),
                        percent(covered[part], 1),
                    )
                )  # fmt: skip
    return Table(
        "Mean Euclidean distance in mm, all payloads",
        ["", "degree", "rigid", "without DI", "estimated DI", "true DI", "observer's tip",
         "interval covers"],
        rows,
        "The interval is the robot's 95\u00a0% prediction interval, per coordinate. It is "
        "calibrated on payloads left out of training, so on payloads that were not it covers more.",
    )  # fmt: skip


def estimators(studies: dict[int, Json]) -> Table:
    """The three estimators of DI on every test."""
    rows = []
    for dof, study in studies.items():
        for test, by_source in study["estimators"].items():
            for source, result in by_source.items():
                rows.append(
                    _row(
                        f"{dof}DOF, {test_title(test)}", source,
                        f"{result['r2_di']:.2f}".replace("-", "−"),
                        f"{100 * result['rms_error_di']:.3f}",
                        f"{MM * result['mean_euclidean_distance_m'][BENEFIT_DEGREE]:.1f}",
                        percent(result["benefit_recovered"][BENEFIT_DEGREE]),
                    )
                )  # fmt: skip
    return Table(
        "Estimators of DI",
        ["", "estimator", "R² of DI", "RMS error, % DI", f"distance at degree {BENEFIT_DEGREE}, mm",
         "gain recovered"],
        rows,
        "Gain: what true DI takes off the mean Euclidean distance against no DI at all. Each "
        "predictor was trained on the DI of its own estimator, on trial 1.",
    )  # fmt: skip


def plant(evaluations: dict[str, Json]) -> Table:
    """Errors of the identified plant by signal, with rigid kinematics for scale."""
    parts = {
        f"{title}, {dof}DOF": part
        for title, evaluation in evaluations.items()
        for dof, part in evaluation["dof"].items()
    }
    names = sorted({name for part in parts.values() for name in part["signals"]})
    rows = [
        _row(_signal(name), *(_error(part["signals"].get(name)) for part in parts.values()))
        for name in names
    ]
    rows.append(_row("tip, all axes", *map(_beside_rigid, parts.values())))
    payloads = list(dict.fromkeys(kg for part in parts.values() for kg in part["payloads"]))
    for kg in payloads:
        of_payload = [part["payloads"].get(kg, {}) for part in parts.values()]
        rows.append(_row(f"tip at {kg} kg", *map(_beside_rigid, of_payload)))
    return Table(
        "Identified plant against trials that it was not fitted to",
        ["", *parts],
        rows,
        "Signals: RMS error, in brackets the mean absolute error. Tip: RMS error, in brackets that "
        "of rigid kinematics, a link that does not bend at the measured angles.",
    )


def _signal(name: str) -> str:
    """Words for a signal: its cells carry the unit."""
    unit = unit_of(name)
    stem = name if unit in (None, "1") else name.rsplit("_", 1)[0]
    return "DI" if name == "di" else stem.replace("_", " ")


def _error(error: Json | None) -> str:
    if error is None:
        return NO_VALUE
    unit, factor = _READABLE.get(error["unit"], (error["unit"], 1.0))
    return f"{factor * error['rms']:.3g}\u00a0{unit} ({factor * error['mae']:.3g})"


def _beside_rigid(part: Json) -> str:
    if part.get("tip_rms_m") is None:
        return NO_VALUE
    return f"{MM * part['tip_rms_m']:.1f}\u00a0mm ({MM * part['rigid_tip_rms_m']:.1f})"


def parameters(plant: Json) -> Table | None:
    """What the trials determined, with standard errors; None where nothing was fitted."""
    fitted = plant.get("provenance", {}).get("fitted_parameters", [])
    rows = [
        _row(
            name,
            f"{row['value']:.4g}".replace("-", "−"),
            NO_VALUE if row.get("error") is None else f"{row['error']:.2g}",
            "" if row["unit"] == "1" else row["unit"].replace(".", "·").replace("m2", "m²"),
        )
        for name in fitted
        if (row := plant["parameters"].get(name))
    ]
    header = ["", "value", "standard error", "unit"]
    return Table("Identified parameters", header, rows) if rows else None


def unit_checks(checks: dict[str, Json]) -> list[Table]:
    """What `fmu check` found, and the parity of every output."""
    names = list(checks)
    kinds = list(dict.fromkeys(c["name"] for check in checks.values() for c in check["checks"]))
    rows = []
    for kind in kinds:
        cells: list[str | TableCell] = []
        for name in names:
            results = [c for c in checks[name]["checks"] if c["name"] == kind]
            passed = all(c["passed"] for c in results)
            text = "; ".join(dict.fromkeys(c["detail"] for c in results))
            cells.append(TableCell(text, passed) if results else TableCell(NO_VALUE))
        rows.append(_row(kind, *cells))
    outputs = list(dict.fromkeys(o for check in checks.values() for o in check["parity"]))
    differing = [o for o in outputs if any(c["parity"].get(o) for c in checks.values())]
    parity = [
        _row(
            output,
            *(
                _judged(check["parity"].get(output), check["parity_limit"], "{:.1e}")
                for check in checks.values()
            ),
        )
        for output in differing
    ]
    equal = len(outputs) - len(differing)
    return [
        Table("Checks", ["", *names], rows),
        Table(
            "Largest difference from the interpreted model",
            ["", *names],
            parity,
            f"{equal} of {len(outputs)} outputs are equal to the last bit, over fixed and varying "
            "steps of the study's motion.",
        ),
    ]


def verdict(loop: LoopRun) -> list[str]:
    """What a run showed, in sentences."""
    timing = loop.timing
    causes = ", ".join(f"{count} {cause}" for cause, count in timing["causes"].items() if count)
    lost = (
        f" In all {timing['misses']} of {timing['slots']} slots were missed ({causes}; longest run "
        f"{timing['longest_run_of_misses']})."
        if causes
        else ""
    )
    bound = percent(timing["own_miss_rate_upper_bound_95"], 2)
    sentences = [
        f"Verdict: {timing['verdict']}; {timing['reason']}.{lost} With 95\u00a0% confidence the "
        f"share missed by our own doing is below {bound}."
        if loop.in_real_time
        else "On the virtual line the clock is simulated: computing takes no time and a run can be "
        "repeated bit by bit, so its durations are the wire's alone."
    ]
    return sentences


def prediction(loop: LoopRun) -> Table | None:
    """How far the robot's prediction was off, by part of the run; None where nobody knows."""
    error = loop.timing.get("prediction_error", {})
    if not error.get("n"):
        return None
    rows = [
        _row(
            _PARTS.get(name, name), str(part["n"]), f"{MM * part['mean_euclidean_distance_m']:.1f}",
            f"{MM * part['p95_m']:.1f}", f"{MM * part['max_m']:.1f}",
            percent(part["interval_coverage"], 1), percent(part["in_range_fraction"], 1),
        )
        for name, part in ({"all": error} | error.get("parts", {})).items()
    ]  # fmt: skip
    return Table(
        "Distance between the robot's prediction and the plant's tip, mm",
        ["", "ticks", "mean", "95\u00a0% of ticks below", "max", "interval covers", "in range"],
        rows,
        "Training saw the motion and nothing else. In the glide and the rest after it the link "
        "swings on while the joints hardly move: angle, current and DI, which has no sign, lie in "
        "the training range there but do not tell which way the link swings, so the range cannot "
        "warn and the interval is too narrow where it covers less than 95\u00a0%.",
    )
