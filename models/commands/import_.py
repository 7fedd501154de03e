"""Import of recordings as trials: names and units mapped, files merged, clocks synchronised.

Every import is checked against the nominal link and gets a page, OUT/NAME.html, that shows the
findings. An import that cannot be right is refused with its likely cause, a doubtful one warned
of. Several files, or a folder, are imported with one map; conditions then come from their names or
from a table ([takes] in the map, docs/trials.md). An import replaces only trials of the same
recordings: neither a file that is read nor any other trial.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from firmware_py.core.console import BAD_INPUT, DONE, emit
from models.trials.importing import import_recordings
from models.trials.recordings import KINDS

EXAMPLE = "dropstitch import take_001.csv --as motive --servo run.mcap --map map.toml --out trials"


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "file", type=Path, nargs="+", metavar="FILE", help="recordings to import, or their folder"
    )
    parser.add_argument(
        "--as", dest="kind", required=True, choices=KINDS, help="format of the recordings"
    )
    parser.add_argument(
        "--servo", type=Path, metavar="LOG",
        help="second file with angle, current and goal: .mcap log of dropstitch run, or a table",
    )  # fmt: skip
    parser.add_argument(
        "--offset", type=float, metavar="SECONDS",
        help="add this to the times of --servo instead of finding the offset by correlation",
    )  # fmt: skip
    parser.add_argument(
        "--map", type=Path, metavar="MAP.toml",
        help="names, units, frame and conditions (docs/trials.md)",
    )  # fmt: skip
    parser.add_argument("--name", help="name of the trial (default: that of FILE)")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="where trials go")


def run(args: argparse.Namespace) -> int:
    takes = import_recordings(
        args.file, args.kind, args.out, mapping=args.map, servo=args.servo, offset_s=args.offset,
        name=args.name or "",
    )  # fmt: skip
    for take in takes:
        for warning in take.warnings():
            print(f"warning: {take.file}: {warning}.", file=sys.stderr)
    if len(takes) == 1:
        emit(args, takes[0].facts, takes[0].summary())
        return DONE
    refused = sum(take.refused for take in takes)
    texts = [take.summary() for take in takes]
    imported = f"{len(takes) - refused} of {len(takes)} takes imported"
    emit(args, {"takes": [take.facts for take in takes]}, "\n".join([*texts, imported]))
    return BAD_INPUT if refused else DONE
