"""Training of the fitted files of the gap workflow, from seeds, on drawn rigs.

    python -m models.gap.training --out build/gap_training

1. The plant's own error: patterns of 22 rigs and 3 changed links each, for one joint and for two.
2. Data sets with and without hidden effects are diagnosed with these patterns.
3. They give the certainty of a name.

Takes about a day on two cores. A stopped run goes on where it was. Both files,
models/gap/estimation/own_error.npz and models/gap/decision/certainty.json, are replaced at the end;
if a data set fails, neither is.
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
from typing import Final, NamedTuple

import msgspec

import models
from firmware_py.core.console import BAD_INPUT, DONE
from firmware_py.core.errors import InputError
from firmware_py.core.motion import Motion
from models.gap.calibration.measurement import (
    PatternWork,
    learned_patterns,
    own_errors_of,
    pattern_sentence,
)
from models.gap.decision import certainty
from models.gap.estimation import own_error
from models.gap.training.case_runs import identification_cases, records_of, run_cases
from models.gap.training.cases import FIRST_TUNING_NUMBER, HiddenCase, tuning_cases
from models.gap.training.fit import fitted_certainty
from models.rig.protocol import TrialCase
from models.shared.missing_files import make_missing

PATTERN_PAYLOADS_KG: Final = (0.0, 0.5, 1.0, 1.5, 2.0)
ROOT: Final = Path(models.__path__[0])
PACKAGES: Final = ("numpy", "scipy", "scikit-learn", "mujoco", "casadi")
FIT: Final = "gap/training/fit.py"
NO_SOURCES: Final = (FIT, "commands", "predictor", "plan", "gap/report", "gap/experiment")
"""Parts of `models` that no measured number depends on; the fit takes seconds."""


class Amount(NamedTuple):
    """How much is measured."""

    joints: tuple[int, ...]  # Numbers of joints that patterns are measured for
    rigs: int  # Rigs of the patterns
    links: int  # Changed links of each
    cases: list[HiddenCase]


def whole_amount(rigs: int) -> Amount:
    numbers = range(FIRST_TUNING_NUMBER, FIRST_TUNING_NUMBER + rigs)
    return Amount((1, 2), 22, 3, [case for k in numbers for case in tuning_cases(k)])


def quick_amount() -> Amount:
    """One data set of each kind on two rigs: tests the command, and is no basis for numbers."""
    cases = [case for k in (0, 1) for case in tuning_cases(FIRST_TUNING_NUMBER + k)]
    first = {
        (case.kind, case.rig): case
        for case in reversed(cases)
        if case.knowledge == "identified" and case.joints == 1
    }
    return Amount((1,), 2, 1, [case for (kind, _), case in first.items() if kind != "pair"])


def main(argv: Sequence[str] | None = None) -> int:
    """Measure what is missing, fit, and replace the fitted files."""
    parser = argparse.ArgumentParser(
        prog="python -m models.gap.training", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("--out", type=Path, required=True, help="directory of the work")
    parser.add_argument("--rigs", type=int, default=40, help="rigs of the data sets (40)")
    parser.add_argument(
        "--quick", action="store_true", help="two rigs, a few data sets; writes to OUT alone"
    )
    args = parser.parse_args(argv)
    try:
        amount = quick_amount() if args.quick else whole_amount(args.rigs)
        made = train(args.out, amount)
    except InputError as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return BAD_INPUT
    if not args.quick:
        replace_together(dict(zip(made, (own_error.PATH, certainty.PATH), strict=True)))
    return DONE


def train(out: Path, amount: Amount) -> tuple[Path, Path]:
    """Measure what is missing in a directory, and fit; return the files of patterns and certainty.

    If a job fails, the others of its step are done, and InputError names the tracebacks.
    """
    made_with = versions()
    begin(out, made_with)
    patterns = measured_patterns(out, amount)
    check(run_cases(amount.cases, out, patterns), out)
    for path in (patterns, ROOT / FIT):
        made_with[path.name] = hashlib.sha256(path.read_bytes()).hexdigest()
    fitted, report = fitted_certainty(records_of(amount.cases, out), made_with)
    print(report)
    made = out / certainty.PATH.name
    made.write_bytes(msgspec.json.format(msgspec.json.encode(fitted), indent=1) + b"\n")
    return patterns, made


def check(failed: int, out: Path) -> None:
    """Refuse to go on if jobs failed."""
    if failed:
        raise InputError(
            str(out / "failures"),
            f"holds the errors of what failed ({failed}), so nothing was replaced",
            "mend what they name, and run the command again",
        )  # fmt: skip


def measured_patterns(out: Path, amount: Amount) -> Path:
    """File with the patterns of the plant's own error."""
    works = [pattern_work(out, joints, amount.links) for joints in amount.joints]
    jobs = {path: job for work in works for path, job in work.jobs(range(amount.rigs)).items()}
    check(make_missing("own error", jobs, failures=out / "failures"), out)
    measured = own_errors_of(list(jobs))
    for key, rigs in measured.items():
        print(f"{key}: {pattern_sentence(rigs)}", flush=True)
    own_error.write_patterns(learned_patterns(measured), out / own_error.PATH.name)
    return out / own_error.PATH.name


def pattern_work(out: Path, joints: int, links: int) -> PatternWork:
    """Measurement of the plant's own error on the study's motion."""
    motion = Motion(dof=joints)
    diagnosed = tuple(TrialCase(motion, payload_kg, 1) for payload_kg in PATTERN_PAYLOADS_KG)
    return PatternWork(
        identification_cases(joints), diagnosed, links, out / f"own_error_{joints}dof"
    )


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


def replace_together(files: dict[Path, Path]) -> None:
    """Copy each file beside its target first, so that an error on the way replaces none."""
    fresh = {target: target.with_suffix(".fresh") for target in files.values()}
    for made, target in files.items():
        shutil.copyfile(made, fresh[target])
    for target, beside in fresh.items():
        beside.replace(target)


if __name__ == "__main__":
    sys.exit(main())
