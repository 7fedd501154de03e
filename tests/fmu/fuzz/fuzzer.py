"""Builds of the FMU's C with a program of calls under sanitizers, and the run of the fuzzer."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple

from fmu.fmu_builder import HEADERS, WRAPPER, core_sources
from fmu.interface import interface_of, write_equations, write_variables
from models.plant.step_model import StepModel

SANITIZERS = (
    "-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all",
    "-fno-omit-frame-pointer",
)  # fmt: skip


class FuzzResult(NamedTuple):
    """Calls made, those that returned OK, and what a sanitizer or a rule objects to."""

    calls: int
    accepted: int
    objection: str


def build_fuzzer(
    model: StepModel,
    fmi: Literal[2, 3],
    directory: Path,
    calls: str = "fuzz_calls.c",
    sanitizers: Sequence[str] = SANITIZERS,
) -> Path:
    """Compile a program of calls with the FMU of a model; the system's gcc has all sanitizers."""
    example = [1.0 if v.name == "torque_nm" else 0.0 for v in model.inputs]
    interface = interface_of(model, "both" if fmi == 3 else "forward", example)
    model_c = write_equations(model, interface, directory)
    variables_c = write_variables(model, interface, "{fuzz}", directory)
    program = directory / f"fuzz_fmi{fmi}"
    sources = [Path(__file__).with_name(calls), *core_sources(fmi), model_c, variables_c]
    subprocess.run(
        [
            os.environ.get("CC", "gcc"), "-std=c99", "-O1", "-g", "-ffp-contract=off", *sanitizers,
            f"-DFMI={fmi}", *(f"-I{path}" for path in (WRAPPER, directory, HEADERS)),
            *map(str, sources), "-o", str(program), "-lm",
        ],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    return program


def fuzz(program: Path, *, seed: int, seconds: float, calls: int = 2**63) -> FuzzResult:
    """Run the fuzzer; a leak, undefined behaviour or a wrong access ends it with a report."""
    done = subprocess.run(
        [str(program), str(seed), str(seconds), str(calls)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    made, accepted = (int(text) for text in (done.stdout.split() or ["0", "0"]))
    return FuzzResult(made, accepted, done.stderr[-4000:] if done.returncode else "")
