"""Cases for tuning: hidden effects on rigs for tuning, faint ones among the usual ones.

    python -m models.gap.training cases --rigs drawn_159 drawn_160 --same-link --out A
    python -m models.gap.training answers A

Probabilities that are fitted to usual effects alone believe what is faint too little. So each rig
has both, of different effects. No rig for testing may be among them.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from firmware_py.console import DONE, NEGATIVE
from models.gap.training.case_runs import run_cases
from models.gap.training.cases import TYPICAL_OF_TWO_JOINTS, hidden_cases
from models.rig.drawn import rig_purpose


def main(argv: Sequence[str] | None = None) -> int:
    """Draw and run."""
    parser = argparse.ArgumentParser(
        prog="python -m models.gap.training cases",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("--rigs", nargs="+", required=True, metavar="NAME", help="rigs for tuning")
    add("--out", type=Path, required=True, help="directory of results")
    add("--same-link", action="store_true", help="the link that the plant was identified on")
    add("--usual", type=int, default=6, help="data sets of each rig with a usual effect")
    add("--faint", type=int, default=4, help="data sets with a faint effect")
    add("--nulls", type=int, default=1, help="data sets without an effect")
    add("--pairs", type=int, default=1, help="data sets with two effects")
    add("--outside", type=int, default=1, help="effect denied to the catalogue")
    add("--joints", type=int, choices=(1, 2), default=1, help="driven joints")
    add(
        "--effects",
        nargs="+",
        default=[],
        choices=TYPICAL_OF_TWO_JOINTS,
        metavar="NAME",
        help="draw from these effects (all)",
    )
    add("--seed", type=int, default=0, help="of the draw")
    args = parser.parse_args(argv)
    for rig in args.rigs:
        if rig_purpose(rig) == "test":
            parser.error(f"{rig} is for testing: nothing is set on it")
    counts = args.usual, args.faint, args.nulls, args.pairs, args.outside
    links = args.seed, args.same_link, args.joints, args.effects
    cases = [c for rig in args.rigs for c in hidden_cases(rig, *counts, *links)]
    if failed := run_cases(cases, args.out):
        print(f"{failed} cases have no result: see {args.out}/failures", file=sys.stderr)
    return NEGATIVE if failed else DONE
