"""Inputs of the page of a closed gap: the files that `make gap-demo` writes.

::

    trials/                     dropstitch simulate --hide …      for the diagnosis
    sealed/                     the same on another motion              held out from all fits
    found/gap.json, plant.json  dropstitch gap
    check_twin_1dof.json        dropstitch fmu check … --json            of the rebuilt FMU
    fmpy_VARIANT_PAYLOAD.json   dropstitch fmu simulate … --json         and …/result.csv
    sil_VARIANT_PAYLOAD/        dropstitch sil --rig --hide …
    plan_VARIANT/               dropstitch sil --rig --hide … --plan    (may be absent)
    commands.log                make gap-demo

Variants:

- `before` and `after` the diagnosis.
- `without` the effect, with FMU and bundle as in `before`: the smallest possible error.
- `retrained` (loop only), on the same trials as `after` with the plant of `before`: the effect of
  new data alone.
- `rigid` (plans only): goals by rigid kinematics.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from hil.report.build_inputs import (
    FmuCheckOutput,
    LoopRun,
    read_commands,
    read_loop,
    read_output,
)
from models.gap.report.gap_json import GapDocument, read_gap_document
from models.plant.plant import Plant, read_plant
from models.trials.files import read_trials
from models.trials.trial import TrialSet

MADE_BY: Final = "run 'make gap-demo'"
VARIANTS: Final = ("before", "retrained", "after", "without")
PLAN_VARIANTS: Final = ("rigid", "before", "after", "without")

ByPayload = dict[float, Any]


class FmuRunOutput(msgspec.Struct, frozen=True):
    """Output of `dropstitch fmu simulate --json` on a trial."""

    rms: dict[str, float]  # RMS error by signal, SI units
    units: dict[str, str]  # SI unit of each signal


@dataclass(frozen=True)
class GapInputs:
    """Files of a closed gap."""

    found: GapDocument  # Diagnosis
    before: Plant  # Plant before the diagnosis
    after: Plant  # Plant after the diagnosis
    trials: TrialSet  # Trials of the diagnosis
    sealed: TrialSet  # Held-out trials, to which no value was fitted
    check: FmuCheckOutput  # Check of the rebuilt twin
    fmus: dict[str, dict[float, FmuRunOutput]]  # Runs of each variant's FMU, by payload in kg
    # Rows of result.csv of those runs, with columns as fields
    outputs: dict[str, dict[float, NDArray[np.void]]]
    loops: dict[str, dict[float, LoopRun]]  # Runs of each variant's loop, by payload in kg
    # RMS path error of a plan, by variant; empty if no plan was run
    path_rms_m: dict[str, float]
    commands: list[str]  # Commands that wrote the files


def read_gap(directory: Path, plant: Path) -> GapInputs:
    """Read the directory and the plant before the diagnosis."""
    for needed in ("found/gap.json", "check_twin_1dof.json"):
        if not (directory / needed).is_file():
            raise InputError(directory / needed, "is missing", MADE_BY)
    before = read_plant(plant)
    return GapInputs(
        found=read_gap_document(directory / "found" / "gap.json"),
        before=before,
        after=read_plant(directory / "found" / "plant.json"),
        trials=read_trials(directory / "trials", before.signals),
        sealed=read_trials(directory / "sealed", before.signals),
        check=read_output(directory / "check_twin_1dof.json", FmuCheckOutput),
        fmus=_variants(directory, "fmpy_{}_{}.json", lambda path: read_output(path, FmuRunOutput)),
        outputs=_variants(directory, "fmpy_{}_{}/result.csv", _columns),
        loops=_variants(directory, "sil_{}_{}/timing.json", lambda path: read_loop(path.parent)),
        path_rms_m={
            v: errors[-1].rms_m
            for v in PLAN_VARIANTS
            if (path := directory / f"plan_{v}").is_dir()
            and (errors := read_loop(path).timing.path_errors)
        },
        commands=read_commands(directory / "commands.log"),
    )


def _variants(directory: Path, pattern: str, read: Callable[[Path], Any]) -> dict[str, ByPayload]:
    """Read the files of every variant, by payload; `before` and `after` are required."""
    result: dict[str, ByPayload] = {}
    for variant in VARIANTS:
        head, tail = pattern.format(variant, "*").split("*")
        paths = {
            float(str(path.relative_to(directory))[len(head) : -len(tail)]): path
            for path in directory.glob(head + "*" + tail)
            if _is_payload(str(path.relative_to(directory))[len(head) : -len(tail)])
        }
        if paths:
            result[variant] = {kg: read(paths[kg]) for kg in sorted(paths)}
    for variant in ("before", "after"):
        if result.get(variant, {}).keys() != result.get("before", {0.0: None}).keys():
            raise InputError(directory / pattern.format(variant, "…"), "is missing", MADE_BY)
    return result


def _is_payload(text: str) -> bool:
    """Whether this part of a name is a payload in kg."""
    return text.replace(".", "", 1).isdecimal()


def _columns(path: Path) -> NDArray[np.void]:
    return np.asarray(np.genfromtxt(path, delimiter=",", names=True))
