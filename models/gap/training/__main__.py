"""Training of `models/gap/decision/certainty.json`, from seeds, on drawn rigs.

    python -m models.gap.training --out build/gap_training

Data sets with and without hidden effects are made and diagnosed; they give the certainty of a name.
Takes some hours on two cores. A stopped run goes on where it was. The file is replaced at the end,
unless a data set failed.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import platform
import shutil
import sys
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Final

import msgspec

import models
from firmware_py.core.console import BAD_INPUT, DONE
from firmware_py.core.errors import InputError
from models.gap.decision import certainty
from models.gap.training.case_runs import records_of, run_cases
from models.gap.training.cases import FIRST_TUNING_NUMBER, HiddenCase, tuning_cases
from models.gap.training.fit import fitted_certainty

ROOT: Final = Path(models.__path__[0])
PACKAGES: Final = ("numpy", "scipy", "scikit-learn", "mujoco", "casadi")
FIT: Final = "gap/training/fit.py"
NO_SOURCES: Final = (FIT, "commands", "predictor", "plan", "study", "gap/report", "gap/experiment")
"""Parts of `models` that no measured number depends on; the fit takes seconds."""


def main(argv: Sequence[str] | None = None) -> int:
    """Measure what is missing, fit, and replace the fitted file."""
    parser = argparse.ArgumentParser(
        prog="python -m models.gap.training", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("--out", type=Path, required=True, help="directory of the work")
    parser.add_argument("--rigs", type=int, default=10, help="rigs of the data sets (10)")
    parser.add_argument(
        "--quick", action="store_true", help="two rigs, a few data sets; writes to OUT alone"
    )
    args = parser.parse_args(argv)
    try:
        fitted = train(args.out, quick_cases() if args.quick else all_cases(args.rigs))
    except InputError as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return BAD_INPUT
    if not args.quick:
        fresh = certainty.PATH.with_suffix(".fresh")
        shutil.copyfile(fitted, fresh)
        fresh.replace(certainty.PATH)
    return DONE


def all_cases(rigs: int) -> list[HiddenCase]:
    numbers = range(FIRST_TUNING_NUMBER, FIRST_TUNING_NUMBER + rigs)
    return [case for number in numbers for case in tuning_cases(number)]


def quick_cases() -> list[HiddenCase]:
    """One data set of each kind on two rigs: tests the command, and is no basis for numbers."""
    first = {
        (case.kind, case.rig): case
        for case in reversed(all_cases(2))
        if case.motion == case.payloads == "study" and case.kind != "pair"
    }
    return list(first.values())


def train(out: Path, cases: Sequence[HiddenCase]) -> Path:
    """Measure what is missing in a directory, and fit; return the fitted file.

    If a data set fails, the others are done, and InputError names the tracebacks.
    """
    made_with = versions()
    begin(out, made_with)
    if failed := run_cases(cases, out):
        raise InputError(
            str(out / "failures"),
            f"holds the errors of what failed ({failed}), so nothing was replaced",
            "mend what they name, and run the command again",
        )  # fmt: skip
    made_with[Path(FIT).name] = hashlib.sha256((ROOT / FIT).read_bytes()).hexdigest()
    fitted, report = fitted_certainty(records_of(cases, out), made_with)
    print(report)
    path = out / certainty.PATH.name
    path.write_bytes(msgspec.json.format(msgspec.json.encode(fitted), indent=1) + b"\n")
    return path


def versions() -> dict[str, str]:
    """Versions of all that the measured numbers depend on, the project's sources by their hash."""
    digest = hashlib.sha256()
    for path in sorted(p for p in ROOT.rglob("*") if p.suffix in (".py", ".toml")):
        name = path.relative_to(ROOT).as_posix()
        if not name.startswith(NO_SOURCES):
            digest.update(name.encode() + path.read_bytes())
    packages = {name: version(name) for name in PACKAGES}
    return {"python": platform.python_version(), **packages, "models": digest.hexdigest()}


def begin(out: Path, made_with: dict[str, str]) -> None:
    """Refuse a directory that was begun by other versions."""
    path = out / "made_with.json"
    if path.exists() and json.loads(path.read_text(encoding="utf-8")) != made_with:
        raise InputError(
            str(path), "names other versions than those of this run",
            "give another --out, or delete this file to go on with what they measured",
        )  # fmt: skip
    out.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(made_with, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
