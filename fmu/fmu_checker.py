"""Checks of an FMU: FMPy's validation, and what that validation does not cover.

The binary exports every function of the standard, every number has an SI unit, a restored state
continues bit by bit, and illegal calls are refused. The FMU contains the parts from which it was
built; its outputs agree with the interpreted model of these parts and with onnxruntime within
`FMU_PARITY`, at fixed and varying steps.
"""

from __future__ import annotations

import ctypes
import re
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from firmware_py.core.motion import Motion
from firmware_py.core.signals import AGE, IN_RANGE, PERIOD_S, feature_names, tip_names
from firmware_py.inference.fmu_instance import check_elf
from firmware_py.inference.predictor import OnnxPredictor, Prediction
from fmu.documents import FMU_PARITY, ReferenceRun, read_reference_run
from fmu.fmpy_instance import FmpyInstance, FmuArchive
from fmu.fmpy_run import inputs_from_motion, usual_payload_kg
from fmu.fmu_builder import HEADERS
from fmu.fmu_models import FmuParts, embedded_parts
from models.plant.step_model import StepModel, names

__all__ = ["FmuReport", "check_fmu"]

Array = NDArray[np.float64]

_STEPS: Final = 256
"""Steps of a parity run: one cycle of the study's motion."""
_DECISIONS: Final = 0.01
"""Largest fraction of rows in which the in-range decision may differ [assumed]."""


class FmuCheck(NamedTuple):
    """Result of one check of an FMU."""

    name: str
    passed: bool
    detail: str


@dataclass(repr=False)
class FmuReport:
    """Result of `check_fmu`.

    Attributes
    ----------
    path : Path
        The .fmu file.
    fmi : int
        Major version of FMI.
    checks : list of FmuCheck
        Checks in the order in which they ran.
    parity : dict of str to float
        Largest difference from the interpreted model by output, in SI units, over fixed and varying
        steps.
    step_us : dict of str to float
        Median time of a step in FMPy in µs: "bare" is the step alone,
        "with_sets_and_gets" includes setting all inputs and getting all outputs.

    Examples
    --------
    >>> report = FmuReport(Path("twin.fmu"), 3, [FmuCheck("units", True, "every number has one")])
    >>> report
    <FmuReport twin.fmu, FMI 3: 1 of 1 checks passed>
    >>> print(report.text())
    ok   units: every number has one
    twin.fmu: sound
    """

    path: Path
    fmi: int
    checks: list[FmuCheck] = field(default_factory=list)
    parity: dict[str, float] = field(default_factory=dict)
    step_us: dict[str, float] = field(default_factory=dict)

    def __repr__(self) -> str:
        passed = sum(check.passed for check in self.checks)
        name = self.path.name
        return f"<FmuReport {name}, FMI {self.fmi}: {passed} of {len(self.checks)} checks passed>"

    def _repr_html_(self) -> str:
        from models.shared.notebook import html_table

        rows = [(c.name, "passed" if c.passed else "FAILED", c.detail) for c in self.checks]
        return html_table(repr(self)[1:-1], ("check", "result", "detail"), rows)

    @property
    def passed(self) -> bool:
        """Whether every check passed."""
        return all(check.passed for check in self.checks)

    def data(self) -> dict[str, Any]:
        """Return the report as plain types, as --json prints it."""
        return {
            "file": str(self.path),
            "fmi": self.fmi,
            "bytes": self.path.stat().st_size,
            "passed": self.passed,
            "checks": [check._asdict() for check in self.checks],
            "parity": self.parity,
            "parity_limit": FMU_PARITY,
            "step_us": self.step_us,
        }

    def text(self) -> str:
        """Return the report as text."""
        lines = [f"{'ok  ' if c.passed else 'FAIL'} {c.name}: {c.detail}" for c in self.checks]
        times = ", ".join(
            f"{us:.0f} µs {what.replace('_', ' ')}" for what, us in self.step_us.items()
        )
        if times:
            lines.append(f"     a step in FMPy: {times}")
        return "\n".join([*lines, f"{self.path}: {'sound' if self.passed else 'NOT sound'}"])


def check_fmu(
    file: Path | str, plant: Path | str | None = None, bundle: Path | str | None = None
) -> FmuReport:
    """Check an FMU: validate it, and compare it with the plant from which it was built.

    An FMU of `build_fmu` contains its plant and predictor, so you need no other file. One of
    another tool is validated only.

    Parameters
    ----------
    file : Path or str
        The .fmu file.
    plant, bundle : Path or str, optional
        Plant or bundle to compare with, instead of those in the FMU.

    Returns
    -------
    FmuReport
        Results of the checks.

    Raises
    ------
    InputError
        If the file is not an FMU, or contains nothing to compare a plant or bundle with.

    Examples
    --------
    >>> import dropstitch
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as directory:
    ...     twin = dropstitch.build_fmu(dropstitch.read_plant(), f"{directory}/twin.fmu")
    ...     report = dropstitch.check_fmu(twin)
    >>> report.passed, report.fmi
    (True, 3)
    """
    with FmuArchive(file) as archive:
        parts = embedded_parts(archive.directory / "resources")
        if plant or bundle:
            if parts is None:
                raise InputError(
                    file, "contains no plant or bundle", "omit the plant and the bundle"
                )
            parts = parts.replaced_by(plant, bundle)
        return _checked(archive, parts)


def _checked(archive: FmuArchive, parts: FmuParts | None) -> FmuReport:
    """Report on an unpacked FMU; without its parts, parity is not tested."""
    report = FmuReport(archive.path, archive.fmi)
    report.checks.append(_validation(archive.path))
    report.checks.append(_units(archive))
    report.checks.append(_exports(archive))
    if not report.checks[-1].passed:
        return report
    report.checks += _refusals(archive)
    report.checks.append(_reference(archive))
    if parts is None:
        untested = "not tested: the FMU does not carry the parts that it was built from"
        report.checks.append(FmuCheck("parity", True, untested))
        return report
    model = parts.model()
    payload_kg = usual_payload_kg(parts)
    u = inputs_from_motion(parts, model, Motion(dof=parts.dof), payload_kg, rows=_STEPS)
    report.checks += _check_step_parity(archive, model, u, report.parity)
    report.checks.append(_check_saved_states(archive, model, u))
    if parts.predictor:
        report.checks.append(_check_onnx_parity(archive, parts, model, u))
    report.step_us.update(_step_times_us(archive, model, u))
    return report


def exported_functions(fmi: int) -> list[str]:
    """Return the names of all functions that the header of FMI 2.0 or 3.0 declares."""
    text = (HEADERS / f"fmi{fmi}Functions.h").read_text(encoding="utf-8")
    return sorted(set(re.findall(rf"fmi{fmi}FullName\((fmi{fmi}\w+)\)", text)))


def _validation(path: Path) -> FmuCheck:
    problems = [" ".join(p.split()) for p in validate_fmu(str(path))]
    return FmuCheck("fmpy validate", not problems, "; ".join(problems) or "no problem")


def _units(archive: FmuArchive) -> FmuCheck:
    numbers = [v for v in archive.description.modelVariables if v.type in ("Real", "Float64")]
    bare = [v.name for v in numbers if not v.unit]
    detail = "missing on " + ", ".join(bare) if bare else f"on all {len(numbers)} numbers"
    return FmuCheck("units", not bare, detail)


def _exports(archive: FmuArchive) -> FmuCheck:
    wanted = exported_functions(archive.fmi)
    try:
        check_elf(archive.binary().read_bytes())
        library = ctypes.CDLL(str(archive.binary()))
    except OSError as error:
        return FmuCheck("binary", False, f"does not load ({error})")
    missing = [name for name in wanted if not hasattr(library, name)]
    detail = "lacks " + ", ".join(missing) if missing else f"exports all {len(wanted)} functions"
    return FmuCheck("binary", not missing, detail)


def _reference(archive: FmuArchive) -> FmuCheck:
    run = read_reference_run(archive.directory)
    if run is None:
        return FmuCheck("reference results", True, "not tested: the FMU holds none")
    return check_reference_run(archive, run)


def _refusals(archive: FmuArchive) -> Iterator[FmuCheck]:
    """Check that illegal calls are refused with a message, and the instance stays usable."""
    variables = archive.description.modelVariables
    with archive.instance() as instance:
        yield _refused(instance, [("a step before initialization", lambda: instance.step(0.1))])
        instance.initialize()
        number = next((v.name for v in variables if v.causality == "input"), None)
        output = next((v.name for v in variables if v.causality == "output"), None)
        settable = [v for v in variables if v.causality in ("input", "parameter")]
        bounded = {v.causality: v for v in settable if v.max is not None}
        wrong: list[tuple[str, Any]] = [("a step of zero", lambda: instance.step(0.0))]
        if number:
            wrong.append(("an input that is not a number", lambda: instance.set({number: np.nan})))
        if output:
            wrong.append(("setting an output", lambda: instance.set({output: 0.0})))
        for causality, v in sorted(bounded.items()):
            beyond = {v.name: float(v.max) + 1.0}
            wrong.append((f"{causality} {v.name} out of bounds", partial(instance.set, beyond)))
        yield _refused(instance, wrong)
        instance.step(PERIOD_S)


def _refused(instance: FmpyInstance, wrong: Sequence[tuple[str, Any]]) -> FmuCheck:
    accepted = []
    for what, call in wrong:
        logged = len(instance.messages)
        try:
            call()
            accepted.append(what)
        except FMICallException:
            if len(instance.messages) == logged:
                accepted.append(f"{what} (refused without a message)")
    names_ = ", ".join(what for what, _ in wrong)
    detail = "accepts " + ", ".join(accepted) if accepted else f"refuses {names_}"
    return FmuCheck("refusals", not accepted, detail)


# ---- Parity -------------------------------------------------------------------------------------


def varying_steps_s(count: int) -> Array:
    """Return communication steps of 0.2 to 2 periods in a quasi-random order, shape (count,)."""
    golden = 0.5 * (np.sqrt(5.0) - 1.0)
    return np.asarray(PERIOD_S * (0.2 + 1.8 * ((np.arange(count) * golden) % 1.0)))


def _simulate(model: StepModel, u: Array, steps_s: Array) -> Array:
    """Outputs of the interpreted model for steps of any length, shape (n + 1, outputs)."""
    p = model.parameter_values()
    x = np.asarray(model.initial(u[0], p)).ravel()
    rows = [np.asarray(model.output(x, u[0], p)).ravel()]
    for row, step_s in zip(u, steps_s, strict=True):
        x = model.advance(x, row, p, float(step_s))
        rows.append(np.asarray(model.output(x, row, p)).ravel())
    return np.array(rows)


def _check_step_parity(
    archive: FmuArchive, model: StepModel, u: Array, largest: dict[str, float]
) -> Iterator[FmuCheck]:
    """Compare the FMU with the interpreted model at fixed and at varying steps.

    `largest` receives the largest difference by output. Shapes: `u` (n, inputs).
    """
    inputs, outputs = names(model.inputs), names(model.outputs)
    runs = {"fixed": np.full(len(u), PERIOD_S), "varying": varying_steps_s(len(u))}
    for kind, steps_s in runs.items():
        with archive.instance() as instance:
            y = instance.run(inputs, u, steps_s, outputs)
        difference = np.abs(y - _simulate(model, u, steps_s))
        _allow_for_decisions(difference, outputs)
        worst = difference.max(axis=0)
        for name, value in zip(outputs, worst, strict=True):
            largest[name] = max(largest.get(name, 0.0), float(value))
        name, value = max(zip(outputs, worst, strict=True), key=lambda pair: pair[1])
        detail = f"{value:.1e} at most ({name}), {len(u)} steps"
        yield FmuCheck(f"parity, {kind} steps", bool(np.all(worst <= FMU_PARITY)), detail)


def _allow_for_decisions(difference: Array, outputs: Sequence[str]) -> None:
    """Ignore the in-range decision if it differs in only a few rows.

    Compiled and interpreted model round differently. If a feature lies on its bound to the last
    digit, one decides "in range", the other not.
    """
    if IN_RANGE.name in outputs:
        rows = difference[:, outputs.index(IN_RANGE.name)]
        if np.count_nonzero(rows) <= _DECISIONS * len(rows):
            rows[:] = 0.0


def check_reference_run(archive: FmuArchive, run: ReferenceRun) -> FmuCheck:
    """Replay the reference run in an FMU and compare the outputs."""
    known = {v.name for v in archive.description.modelVariables}
    unknown = [name for name in (*run.inputs, *run.outputs) if name not in known]
    if unknown:
        return FmuCheck("reference results", False, f"name the unknown variable {unknown[0]}")
    with archive.instance() as instance:
        steps_s = np.full(len(run.u) - 1, run.step_s)
        y = instance.run(run.inputs, run.u[:-1], steps_s, run.outputs)
    rows = np.rint(run.times_s / run.step_s).astype(int)
    worst = float(np.abs(y[rows] - run.y).max())
    return FmuCheck(
        "reference results", worst <= FMU_PARITY, f"{worst:.1e} at most, {len(rows)} rows"
    )


def _check_onnx_parity(
    archive: FmuArchive, parts: FmuParts, model: StepModel, u: Array
) -> FmuCheck:
    """Compare the FMU's prediction with onnxruntime's for the same features.

    Shapes: `u` (n, inputs).
    """
    wanted = [*tip_names("predicted_"), IN_RANGE.name]
    shown = [*names(model.inputs), *names(model.outputs)]
    predictor = OnnxPredictor(parts.required_predictor(), parts.dof)
    asked = [n for n in (*feature_names(parts.dof), AGE.name, *predictor.wanted) if n in shown]
    with archive.instance() as instance:
        y = instance.run(names(model.inputs), u, np.full(len(u), PERIOD_S), (*asked, *wanted))
    worst = 0.0
    for row in y[1:]:
        known = dict(zip(asked, row, strict=False))
        answer = _predict(predictor, parts.dof, known)
        expected = [*answer.tip_m, answer.in_range]
        worst = max(worst, float(np.abs(row[len(asked) :] - expected).max()))
    return FmuCheck("parity with onnxruntime", worst <= FMU_PARITY, f"{worst:.1e} at most")


def _predict(predictor: OnnxPredictor, dof: int, known: Mapping[str, float]) -> Prediction:
    """Prediction for inputs by name; missing inputs are zero."""

    def values(wanted: Sequence[str]) -> Array:
        return np.array([known.get(name, 0.0) for name in wanted])

    features = values(feature_names(dof))
    age_s = known.get(AGE.name, 0.0)
    return predictor.predict(
        features[:dof], features[dof : 2 * dof], features[-1], values(predictor.wanted), age_s
    )


def _check_saved_states(archive: FmuArchive, model: StepModel, u: Array) -> FmuCheck:
    """Check that runs continued from a saved state are equal to the last bit.

    The state is saved half way. The run continues three times: directly, after the state is
    restored, and in a second instance from the serialised state. Shapes: `u` (n, inputs).
    """
    inputs, outputs = names(model.inputs), names(model.outputs)
    half = len(u) // 2
    steps_s = np.full(len(u), PERIOD_S)

    def second_half(instance: FmpyInstance) -> list[Array]:
        instance.time_s = half_s
        return instance.go_on(inputs, u[half:], steps_s[half:], outputs)

    with archive.instance() as first, archive.instance() as second:
        first.run(inputs, u[:half], steps_s[:half], outputs)
        state, half_s = first.fmu.getFMUState(), first.time_s
        data = first.fmu.serializeFMUState(state)
        runs = [second_half(first)]
        first.fmu.setFMUState(state)
        runs.append(second_half(first))
        first.fmu.freeFMUState(state)
        copy = second.fmu.deserializeFMUState(data)
        second.fmu.setFMUState(copy)
        second.fmu.freeFMUState(copy)
        runs.append(second_half(second))
    same = all(np.array_equal(run, runs[0]) for run in runs)
    detail = "restored and deserialized runs are bit-identical" if same else "runs differ"
    return FmuCheck("state", same, f"{detail}, {len(data)} bytes")


def _step_times_us(archive: FmuArchive, model: StepModel, u: Array) -> dict[str, float]:
    """Measure the median times of a step, see `FmuReport`. Shapes: `u` (n, inputs)."""
    inputs, outputs = names(model.inputs), names(model.outputs)
    bare, whole = [], []
    with archive.instance() as instance:
        instance.initialize(dict(zip(inputs, u[0], strict=True)))
        for row in u:
            start_ns = time.perf_counter_ns()
            instance.set(dict(zip(inputs, row, strict=True)))
            before_ns = time.perf_counter_ns()
            instance.step(PERIOD_S)
            after_ns = time.perf_counter_ns()
            instance.get(outputs)
            bare.append(after_ns - before_ns)
            whole.append(time.perf_counter_ns() - start_ns)
    medians = {"bare": np.median(bare), "with_sets_and_gets": np.median(whole)}
    return {what: float(ns) / 1e3 for what, ns in medians.items()}
