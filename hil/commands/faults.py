"""Inject every fault of the fault table, with a seed, and check the robot's reaction.

Writes to OUT: faults.json, faults.xml (JUnit) and report.html (the matrix). They are updated after
each case, so that a campaign that you end early leaves its results, marked as incomplete. Exit 0:
every fault had the expected outcome. Exit 1: at least one did not. Exit 3, inconclusive: the host
preempted the loop.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import msgspec

from firmware_py.core.console import emit
from firmware_py.core.errors import InputError
from firmware_py.core.output_files import make_directory
from firmware_py.inference.bundle import ModelBundle
from hil.faults.fault_row import LINES

if TYPE_CHECKING:
    from hil.faults.faults_document import CaseVerdict, FaultsDocument

EXAMPLE = "dropstitch faults --bundle build/bundle_2dof --out build/faults"


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--bundle", type=Path, required=True, metavar="BUNDLE", help="bundle of the robot"
    )
    parser.add_argument("--out", type=Path, required=True, help="directory for the results")
    parser.add_argument(
        "--fmu", type=Path, help="twin behind the servos (default: built from the bundle's plant)"
    )
    parser.add_argument(
        "--line", nargs="+", choices=LINES, default=LINES,
        help="simulated time, real time, real processes (default: all)",
    )  # fmt: skip
    parser.add_argument("--only", metavar="WORDS", help="faults of these words, as 'servo silent'")
    parser.add_argument("--seed", type=int, default=1, help="the first (default: %(default)s)")
    parser.add_argument(
        "--seeds", type=int, default=1, metavar="N", help="on the virtual line (default: 1)"
    )


def run(args: argparse.Namespace) -> int:
    from hil.emulator.physics import build_twin
    from hil.faults.campaign import cases_of, run_campaign
    from hil.faults.case_robot import CaseRobot
    from hil.faults.fault_table import ROWS
    from hil.faults.faults_document import faults_document

    if args.seeds < 1:
        raise InputError("--seeds", f"is {args.seeds}", "give at least 1")
    bundle = ModelBundle.load(args.bundle)
    rows = [row for row in ROWS if (args.only or "") in f"{row.fault}, {row.how}"]
    seeds = range(args.seed, args.seed + args.seeds)
    cases = cases_of(bundle.manifest.dof, args.line, seeds, rows)
    if not rows:
        raise InputError(
            "--only", f"'{args.only}' is in the name of no fault",
            "see docs/safety/faults.md for names",
        )  # fmt: skip
    if not cases:
        if all(row.joints > bundle.manifest.dof for row in rows):
            raise InputError(
                "--only", f"'{args.only}' needs two joints", "give a bundle of two joints"
            )
        lines = " ".join(sorted({line for row in rows for line in row.lines}))
        raise InputError("--only", f"'{args.only}' runs on another line", f"give --line {lines}")
    make_directory(args.out, "name another --out")
    with TemporaryDirectory(prefix="dropstitch-faults-") as scratch:
        plant = bundle.directory / "plant.json"
        fmu = args.fmu or build_twin(plant, bundle.manifest.dof, Path(scratch))
        judged: Sequence[CaseVerdict] = ()

        def keep(so_far: Sequence[CaseVerdict]) -> None:
            nonlocal judged
            judged = so_far
            left = len(cases) - len(judged)
            _write(args.out, faults_document(bundle.manifest, judged, left), judged)

        try:
            run_campaign(CaseRobot(bundle, fmu), cases, keep)
        finally:
            if 0 < len(judged) < len(cases):
                print(
                    f"incomplete: {len(judged)} of {len(cases)} cases were run; see "
                    f"{args.out}/report.html and faults.json", file=sys.stderr
                )  # fmt: skip
    document = faults_document(bundle.manifest, judged)
    emit(args, msgspec.to_builtins(document), describe_campaign(judged, document, args.out))
    return document.verdict.exit_code


def _write(out: Path, document: FaultsDocument, judged: Sequence[CaseVerdict]) -> None:
    from firmware_py.core.documents import write_document
    from firmware_py.core.output_files import write_whole
    from hil.faults.faults_document import faults_junit
    from hil.report.build_page import fault_page
    from models.shared.pages import write_page

    write_document(out / "faults.json", document)
    write_whole(out / "faults.xml", faults_junit(judged, document.not_run))
    write_page(out / "report.html", fault_page(document))


def describe_campaign(judged: Sequence[CaseVerdict], document: FaultsDocument, out: Path) -> str:
    """Return the cases that did not pass, then the counts, as text."""
    lines = [
        f"{one.verdict}: {one.case.name}: {'; '.join(one.complaints)}"
        for one in judged
        if one.verdict != "pass"
    ]
    counts = {verdict.value: count for verdict, count in document.counts.items()}
    lines.append(
        f"{document.verdict}: {document.faults} faults in {len(judged)} cases, "
        f"{counts['pass']} passed, {counts['fail']} failed, {counts['inconclusive']} inconclusive"
    )
    lines.append(f"see {out}/report.html and faults.json")
    return "\n".join(lines)
