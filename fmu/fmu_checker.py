"""Is a unit sound? FMPy's validation, and what that does not look at.

The binary exports every function of the standard, every number has a unit, a saved state
continues bit by bit, calls that must be refused are refused, and the unit follows the interpreted
model that it was built from (it carries the parts) within `PARITY`, fixed and varying steps.
"""

from __future__ import annotations

import ctypes
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu

from firmware_py.motion import Motion
from firmware_py.signals import PERIOD_S
from fmu.fmpy_instance import Archive, Instance
from fmu.fmu_builder import HEADERS
from fmu.fmu_models import Parts
from fmu.parity import PARITY, Check, onnx_parity, parity, saved_states, step_times_us
from fmu.stimulus import motion_inputs

PAYLOAD_KG: Final = 1.0
STEPS: Final = 256
"""Steps of a parity run: one cycle of the study, both directions."""


@dataclass
class Report:
    """What a check found.

    Attributes
    ----------
    path : Path
        The unit.
    fmi : int
        Version of the standard.
    checks : list of Check
        In the order in which they ran.
    parity : dict of str to float
        Largest difference from the interpreted model by output, over fixed and varying steps.
    step_us : dict of str to float
        Median time of a step in FMPy: "bare", and "with_sets_and_gets" of all inputs and outputs.
    """

    path: Path
    fmi: int
    checks: list[Check] = field(default_factory=list)
    parity: dict[str, float] = field(default_factory=dict)
    step_us: dict[str, float] = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        """Everything holds."""
        return all(check.passed for check in self.checks)

    def data(self) -> dict[str, Any]:
        """As plain types."""
        return {
            "file": str(self.path),
            "fmi": self.fmi,
            "bytes": self.path.stat().st_size,
            "passed": self.passed,
            "checks": [check._asdict() for check in self.checks],
            "parity": self.parity,
            "parity_limit": PARITY,
            "step_us": self.step_us,
        }

    def text(self) -> str:
        """For people."""
        lines = [f"{'ok  ' if c.passed else 'FAIL'} {c.name}: {c.detail}" for c in self.checks]
        times = ", ".join(
            f"{us:.0f} µs {what.replace('_', ' ')}" for what, us in self.step_us.items()
        )
        if times:
            lines.append(f"     a step in FMPy: {times}")
        return "\n".join([*lines, f"{self.path}: {'sound' if self.passed else 'NOT sound'}"])


def check_unit(archive: Archive, parts: Parts | None) -> Report:
    """Check an unpacked unit.

    Parameters
    ----------
    archive : Archive
        The unit.
    parts : Parts or None
        What it was built from; without them its numbers cannot be judged.
    """
    report = Report(archive.path, archive.fmi)
    report.checks.append(_validation(archive.path))
    report.checks.append(_units(archive))
    report.checks.append(_exports(archive))
    if not report.checks[-1].passed:
        return report
    report.checks += _refusals(archive)
    if parts is None:
        report.checks.append(
            Check("parity", True, "not judged: the unit does not carry what it was built from")
        )
        return report
    model = parts.model()
    u = motion_inputs(parts, model, Motion(dof=parts.dof), PAYLOAD_KG)[:STEPS]
    report.checks += parity(archive, model, u, report.parity)
    report.checks.append(saved_states(archive, model, u))
    if parts.predictor:
        report.checks.append(onnx_parity(archive, parts, model, u))
    report.step_us.update(step_times_us(archive, model, u))
    return report


def exported_functions(fmi: int) -> list[str]:
    """Names of every function that the standard's header declares."""
    text = (HEADERS / f"fmi{fmi}Functions.h").read_text(encoding="utf-8")
    return sorted(set(re.findall(rf"fmi{fmi}FullName\((fmi{fmi}\w+)\)", text)))


def _validation(path: Path) -> Check:
    problems = [" ".join(p.split()) for p in validate_fmu(str(path))]
    return Check("fmpy validate", not problems, "; ".join(problems) or "no problem")


def _units(archive: Archive) -> Check:
    numbers = [v for v in archive.description.modelVariables if v.type in ("Real", "Float64")]
    bare = [v.name for v in numbers if not v.unit]
    detail = "missing on " + ", ".join(bare) if bare else f"on all {len(numbers)} numbers"
    return Check("units", not bare, detail)


def _exports(archive: Archive) -> Check:
    wanted = exported_functions(archive.fmi)
    try:
        library = ctypes.CDLL(str(archive.binary()))
    except OSError as error:
        return Check("binary", False, f"does not load ({error})")
    missing = [name for name in wanted if not hasattr(library, name)]
    detail = "misses " + ", ".join(missing) if missing else f"exports all {len(wanted)} functions"
    return Check("binary", not missing, detail)


def _refusals(archive: Archive) -> Iterator[Check]:
    """Each wrong call is refused with a sentence, and the instance lives on."""
    variables = archive.description.modelVariables
    with archive.instance() as instance:
        wrong: list[tuple[str, Any]] = [
            ("a step before initialization", lambda: instance.step(0.1))
        ]
        yield _refused(instance, wrong)
        instance.initialize()
        number = next((v.name for v in variables if v.causality == "input"), None)
        output = next((v.name for v in variables if v.causality == "output"), None)
        bounded = next((v for v in variables if v.causality == "parameter" and v.max), None)
        wrong = [("a step of zero", lambda: instance.step(0.0))]
        if number:
            wrong.append(("an input that is no number", lambda: instance.set({number: np.nan})))
        if output:
            wrong.append(("setting an output", lambda: instance.set({output: 0.0})))
        if bounded:
            beyond = float(bounded.max) + 1.0
            wrong.append(("a parameter out of range", lambda: instance.set({bounded.name: beyond})))
        yield _refused(instance, wrong)
        instance.step(PERIOD_S)


def _refused(instance: Instance, wrong: Sequence[tuple[str, Any]]) -> Check:
    taken = []
    for what, call in wrong:
        told = len(instance.messages)
        try:
            call()
            taken.append(what)
        except FMICallException:
            if len(instance.messages) == told:
                taken.append(f"{what} (refused without a sentence)")
    names_ = ", ".join(what for what, _ in wrong)
    detail = "takes " + ", ".join(taken) if taken else f"refuses {names_}"
    return Check("refusals", not taken, detail)
