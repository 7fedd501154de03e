"""Validate an FMU and compare it with the plant from which it was built.

The FMU contains its plant and predictor, so you need no other file. With --plant and --bundle, you
test whether it agrees with another plant or bundle instead.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from firmware_py.core.console import DONE, NEGATIVE, emit

EXAMPLE = "dropstitch fmu check build/twin_1dof.fmu"


def configure(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("file", type=Path, metavar="FILE.fmu", help="the FMU")
    add("--plant", type=Path, metavar="PLANT", help="compare with this plant")
    add("--bundle", type=Path, metavar="BUNDLE", help="compare with this bundle's predictor")


def run(args: argparse.Namespace) -> int:
    from fmu.fmu_checker import check_fmu

    report = check_fmu(args.file, args.plant, args.bundle)
    emit(args, report.data(), report.text())
    return DONE if report.passed else NEGATIVE
