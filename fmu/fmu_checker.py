"""Checks of an FMU: FMPy's validation, and what that validation does not cover.

The binary exports every function of the standard, every number has an SI unit, a restored state
continues bit by bit, and illegal calls are refused. The FMU contains the parts from which it was
built; its outputs agree with the interpreted model of these parts within `FMU_PARITY`, at fixed and
varying steps.
"""

from __future__ import annotations

import ctypes
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu

from firmware_py.core.motion import Motion
from firmware_py.core.signals import PERIOD_S
from firmware_py.system.targets import FMU_PARITY
from fmu.fmpy_instance import FmpyInstance, FmuArchive
from fmu.fmu_builder import HEADERS
from fmu.fmu_models import FmuParts
from fmu.packaging.reference_run import read_reference_run
from fmu.parity import (
    FmuCheck,
    check_onnx_parity,
    check_reference_run,
    check_saved_states,
    check_step_parity,
    step_times_us,
)
from fmu.stimulus import inputs_from_motion, usual_payload_kg

__all__ = ["FmuReport", "check_fmu"]

STEPS: Final = 256
"""Steps of a parity run: one cycle of the study's motion."""


@dataclass
class FmuReport:
    """Result of the checks of an FMU.

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
        Median time of a step in FMPy in µs (see `fmu.parity.step_times_us`).
    """

    path: Path
    fmi: int
    checks: list[FmuCheck] = field(default_factory=list)
    parity: dict[str, float] = field(default_factory=dict)
    step_us: dict[str, float] = field(default_factory=dict)

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


def check_fmu(archive: FmuArchive, parts: FmuParts | None) -> FmuReport:
    """Check an unpacked FMU.

    Parameters
    ----------
    archive : FmuArchive
        Unpacked FMU.
    parts : FmuParts or None
        Parts from which it was built; without them the parity checks are skipped.

    Returns
    -------
    FmuReport
        Results of the checks.
    """
    report = FmuReport(archive.path, archive.fmi)
    report.checks.append(_validation(archive.path))
    report.checks.append(_units(archive))
    report.checks.append(_exports(archive))
    if not report.checks[-1].passed:
        return report
    report.checks += _refusals(archive)
    report.checks.append(_reference(archive))
    if parts is None:
        report.checks.append(
            FmuCheck(
                "parity",
                True,
                "not tested: the FMU does not carry the parts that it was built from",
            )
        )
        return report
    model = parts.model()
    held_kg = usual_payload_kg(parts)
    u = inputs_from_motion(parts, model, Motion(dof=parts.dof), held_kg, rows=STEPS)
    report.checks += check_step_parity(archive, model, u, report.parity)
    report.checks.append(check_saved_states(archive, model, u))
    if parts.predictor:
        report.checks.append(check_onnx_parity(archive, parts, model, u))
    report.step_us.update(step_times_us(archive, model, u))
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
        wrong: list[tuple[str, Any]] = [
            ("a step before initialization", lambda: instance.step(0.1))
        ]
        yield _refused(instance, wrong)
        instance.initialize()
        number = next((v.name for v in variables if v.causality == "input"), None)
        output = next((v.name for v in variables if v.causality == "output"), None)
        settable = [v for v in variables if v.causality in ("input", "parameter")]
        bounded = {v.causality: v for v in settable if v.max is not None}
        wrong = [("a step of zero", lambda: instance.step(0.0))]
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
        told = len(instance.messages)
        try:
            call()
            accepted.append(what)
        except FMICallException:
            if len(instance.messages) == told:
                accepted.append(f"{what} (refused without a message)")
    names_ = ", ".join(what for what, _ in wrong)
    detail = "accepts " + ", ".join(accepted) if accepted else f"refuses {names_}"
    return FmuCheck("refusals", not accepted, detail)
