"""Parity of an FMU's outputs with the interpreted model and with onnxruntime."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.signals import AGE, DI, IN_RANGE, PERIOD_S, feature_names, tip_names
from firmware_py.inference.predictor import OnnxPredictor, Prediction
from firmware_py.system.targets import FMU_PARITY
from fmu.fmpy_instance import FmpyInstance, FmuArchive
from fmu.fmu_models import FmuParts
from fmu.packaging.reference_run import ReferenceRun
from models.plant.step_model import StepModel, names

Array = NDArray[np.float64]

DECISIONS: Final = 0.01
"""Largest fraction of rows in which the in-range decision may differ [assumed]."""


class FmuCheck(NamedTuple):
    """Result of one check of an FMU."""

    name: str
    passed: bool
    detail: str


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


def check_step_parity(
    archive: FmuArchive, model: StepModel, u: Array, found: dict[str, float]
) -> Iterator[FmuCheck]:
    """Compare the FMU with the interpreted model at fixed and at varying steps.

    `found` receives the largest difference by output. Shapes: `u` (n, inputs).
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
            found[name] = max(found.get(name, 0.0), float(value))
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
        if np.count_nonzero(rows) <= DECISIONS * len(rows):
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


def check_onnx_parity(archive: FmuArchive, parts: FmuParts, model: StepModel, u: Array) -> FmuCheck:
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
        answer = predict_named(predictor, parts.dof, known)
        expected = [*answer.tip_m, answer.in_range]
        worst = max(worst, float(np.abs(row[len(asked) :] - expected).max()))
    return FmuCheck("parity with onnxruntime", worst <= FMU_PARITY, f"{worst:.1e} at most")


def predict_named(predictor: OnnxPredictor, dof: int, known: Mapping[str, float]) -> Prediction:
    """Return the prediction for inputs by name; missing inputs are zero."""
    joints = range(1, dof + 1)
    angle_rad = np.array([known.get(f"angle_{j}_rad", 0.0) for j in joints])
    current_a = np.array([known.get(f"current_{j}_a", 0.0) for j in joints])
    signals = np.array([known.get(name, 0.0) for name in predictor.wanted])
    di, age_s = known.get(DI.name, 0.0), known.get(AGE.name, 0.0)
    return predictor.predict(angle_rad, current_a, di, signals, age_s)


def check_saved_states(archive: FmuArchive, model: StepModel, u: Array) -> FmuCheck:
    """Check that runs continued from a saved state are equal to the last bit.

    The state is saved half way. The run continues three times: directly, after the state is
    restored, and in a second instance from the serialised state. Shapes: `u` (n, inputs).
    """
    inputs, outputs = names(model.inputs), names(model.outputs)
    half = len(u) // 2
    with archive.instance() as first, archive.instance() as second:
        first.run(inputs, u[:half], np.full(half, PERIOD_S), outputs)
        state, time_s = first.fmu.getFMUState(), first.time_s
        data = first.fmu.serializeFMUState(state)
        runs = [_continue(first, inputs, u[half:], outputs)]
        first.fmu.setFMUState(state)
        first.time_s = second.time_s = time_s
        runs.append(_continue(first, inputs, u[half:], outputs))
        first.fmu.freeFMUState(state)
        copy = second.fmu.deserializeFMUState(data)
        second.fmu.setFMUState(copy)
        second.fmu.freeFMUState(copy)
        runs.append(_continue(second, inputs, u[half:], outputs))
    same = all(np.array_equal(run, runs[0]) for run in runs)
    detail = "restored and deserialized runs are bit-identical" if same else "runs differ"
    return FmuCheck("state", same, f"{detail}, {len(data)} bytes")


def _continue(
    instance: FmpyInstance, inputs: Sequence[str], u: Array, outputs: Sequence[str]
) -> Array:
    rows = []
    for row in u:
        instance.set(dict(zip(inputs, row, strict=True)))
        instance.step(PERIOD_S)
        rows.append(instance.get(outputs))
    return np.array(rows)


def step_times_us(archive: FmuArchive, model: StepModel, u: Array) -> dict[str, float]:
    """Measure the median time of a step in FMPy, in µs.

    "bare" is the step alone, "with_sets_and_gets" includes setting all inputs and getting all
    outputs. Shapes: `u` (n, inputs).
    """
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
