"""Fuzzer of the FMU's calls, in C under sanitizers: `python -m tests.fmu.fuzz --seconds 600`.

Prints one line of JSON: calls made and calls that returned OK, of both versions of FMI together.
"""

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal, NamedTuple

from fmu.fmu_builder import HEADERS, WRAPPER, core_sources
from fmu.interface import interface_of, write_equations, write_variables
from models.plant.step_model import StepModel
from tests.fmu.toy import pendulum

SANITIZERS = (
    "-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all",
    "-fno-omit-frame-pointer",
)  # fmt: skip


class FuzzResult(NamedTuple):
    """Calls made, those that returned OK, and what a sanitizer or a rule objects to."""

    calls: int
    accepted: int
    objection: str


def build_fuzzer(model: StepModel, fmi: Literal[2, 3], directory: Path) -> Path:
    """Compile the fuzzer with the FMU of a model; the system's gcc has all sanitizers."""
    example = [1.0 if v.name == "torque_nm" else 0.0 for v in model.inputs]
    interface = interface_of(model, "both" if fmi == 3 else "forward", example)
    model_c = write_equations(model, interface, directory)
    variables_c = write_variables(model, interface, "{fuzz}", directory)
    program = directory / f"fuzz_fmi{fmi}"
    sources = [Path(__file__).with_name("fuzz_calls.c"), *core_sources(fmi), model_c, variables_c]
    subprocess.run(
        [
            os.environ.get("CC", "gcc"), "-std=c99", "-O1", "-g", "-ffp-contract=off", *SANITIZERS,
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


def main() -> int:
    """Fuzz both versions of FMI, half of the time each; 1 if a sanitizer or a rule objects."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    total = {"calls": 0, "accepted": 0}
    for fmi in (2, 3):
        with TemporaryDirectory() as directory:
            program = build_fuzzer(pendulum(), fmi, Path(directory))
            result = fuzz(program, seed=args.seed, seconds=args.seconds / 2)
        total["calls"] += result.calls
        total["accepted"] += result.accepted
        if result.objection:
            print(result.objection, file=sys.stderr)
            return 1
    print(json.dumps(total))
    return 0


if __name__ == "__main__":
    sys.exit(main())
