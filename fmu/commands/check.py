"""Validate a unit and compare its numbers with the plant that it was built from.

The unit carries its plant and predictor, so nothing else is needed; --plant and --bundle put
others in their place, to ask whether the unit is still theirs.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from firmware_py.console import DONE, NEGATIVE, emit
from firmware_py.errors import InputError

EXAMPLE = "python -m fmu check build/twin_1dof.fmu"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add("file", type=Path, metavar="FILE.fmu", help="the unit")
    add("--plant", type=Path, metavar="PLANT", help="compare with this plant")
    add("--bundle", type=Path, metavar="BUNDLE", help="compare with this bundle's predictor")


def run(args: argparse.Namespace) -> int:
    """Check; exit 1 where the unit is not sound."""
    from fmu.fmpy_instance import Archive
    from fmu.fmu_checker import check_unit
    from fmu.fmu_models import parts_inside

    with Archive(args.file) as archive:
        parts = parts_inside(archive.directory / "resources")
        if args.plant or args.bundle:
            if parts is None:
                raise InputError(args.file, "does not say what it is", "check it without a plant")
            parts = parts.instead(args.plant, args.bundle)
        report = check_unit(archive, parts)
    emit(args, report.data(), report.text())
    return DONE if report.passed else NEGATIVE
