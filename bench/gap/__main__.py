"""Benchmark of the gap workflow, by rig.

    python -m bench.gap --plant build/plant.json --out build/bench_gap
    python -m bench.gap --rigs default drive test_a --out build/bench_rigs
    python -m bench.gap --like build/bench_rigs --out build/bench_rigs_now

With --plant, cases of the default rig. With --rigs, cases of each rig, with a plant that is
identified on that rig first. With --like, the cases of another run, to compare two versions.
It runs as a campaign does (docs/campaigns.md): a rerun does what is missing, or of other code; with
--scheduler it runs on a dask cluster. Leaves figures, confusion matrices, a table by rig and the
reliability of the probabilities in OUT/summary.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from itertools import cycle
from pathlib import Path

from bench.gap.bench_kind import cases_of_run
from bench.gap.benchmark_run import run_benchmark
from bench.gap.cases import (
    DEFAULT_RIG,
    MOTIONS,
    PAYLOAD_SETS,
    BenchCase,
    draw_cases,
    in_one_servo,
    mixed_cases,
)
from bench.gap.scores.rig_table import rig_table_text
from bench.gap.scores.summary_files import write_bench_summary
from firmware_py.errors import InputError
from hil.campaign.engines.engine import Engine
from models.rig.drawn_rig import rig_named
from models.rig.rig_structure import named_structures


def main() -> None:
    """Draw, run, summarise."""
    parser = _parser()
    args = parser.parse_args()
    if sum(map(bool, (args.plant, args.rigs, args.like))) != 1:
        parser.error("give one of --plant, --rigs and --like")
    if (args.motions, args.payloads) != (["study"], "study") and not args.no_sealed:
        parser.error("sealed trials have motions and payloads of their own: give --no-sealed")
    if args.one_servo and args.joints != 2:
        parser.error("--one-servo goes with --joints 2")
    if args.told and not args.same_link:
        parser.error("--told goes with --same-link")
    for name in args.rigs:
        try:
            rig_named(name)
        except InputError as error:
            parser.error(str(error))
    counts = run_benchmark(
        _cases(args),
        args.plant,
        args.out,
        _engine(args),
        not args.no_sealed,
        args.calibrate,
        args.plants_of,
    )
    if lost := sum(counts.ran.values()) - counts.ran.get("done", 0):
        print(f"{lost} cases have no result: see {args.out}/failures", file=sys.stderr)
    figures, by_rig = write_bench_summary(args.out)
    print(json.dumps(figures, indent=1) if args.plant else rig_table_text(by_rig))


def _parser() -> argparse.ArgumentParser:
    """Options of the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--plant", type=Path, help="identified on the default rig without effects")
    add(
        "--rigs", nargs="+", default=[], metavar="NAME",
        help="rigs, each with a plant of its own: drawn_K, " + ", ".join(named_structures()),
    )  # fmt: skip
    add("--out", type=Path, required=True, help="directory of results")
    add("--singles", type=int, default=4, help="cases of each effect and size")
    add("--nulls", type=int, default=150, help="data sets without an effect")
    add("--pairs", type=int, default=30, help="data sets with two effects")
    add("--outside", type=int, default=20, help="effect denied to the catalogue")
    add("--most", type=int, help="at most so many cases of each rig, of all kinds in turn")
    add("--seed", type=int, default=0, help="of the draw")
    add("--joints", type=int, choices=(1, 2), default=1, help="driven joints")
    add(
        "--motions", nargs="+", choices=MOTIONS, default=["study"], metavar="NAME",
        help="motions of the trials, for the rigs in turn: " + ", ".join(MOTIONS),
    )  # fmt: skip
    add(
        "--plants-of", choices=MOTIONS, default="", metavar="NAME",
        help="motion that plants are identified on (that of the trials)",
    )  # fmt: skip
    add(
        "--calibrate", type=int, default=0, metavar="RIGS",
        help="drawn rigs on which patterns are measured for each motion but the study's (none)",
    )  # fmt: skip
    add(
        "--payloads", choices=PAYLOAD_SETS, default="study", metavar="NAME",
        help="payloads of the trials: study, or between those that the plant was identified on",
    )  # fmt: skip
    add("--same-link", action="store_true", help="the link that the plant was identified on")
    add("--one-servo", action="store_true", help="with two joints, effects of one servo alone")
    add("--told", action="store_true", help="tell the diagnosis that the link is the same")
    add("--like", type=Path, metavar="DIR", help="the cases of another run, by its results")
    add("--no-sealed", action="store_true", help="leave out the test on sealed trials")
    add("--scheduler", metavar="ADDRESS", help="of a dask cluster, in place of two processes")
    return parser


def _engine(args: argparse.Namespace) -> Engine | None:
    """Engine of the command line; None for processes of this machine."""
    if not args.scheduler:
        return None
    from hil.campaign.engines.dask_engine import DaskEngine

    return DaskEngine(args.scheduler)


def _cases(args: argparse.Namespace) -> list[BenchCase]:
    """Cases of the command line."""
    if args.like:
        return cases_of_run(args.like)
    cases: list[BenchCase] = []
    for rig, motion in zip(args.rigs or [DEFAULT_RIG], cycle(args.motions)):
        counts = args.singles, args.nulls, args.pairs, args.outside
        own = list(draw_cases(*counts, args.seed, rig, args.same_link, args.joints))
        own = in_one_servo(own, rig_named(rig)) if args.one_servo else own
        own = own if args.most is None else mixed_cases(own, args.most)
        told = {"motion": motion, "payloads": args.payloads, "told_same_link": args.told}
        cases += [replace(case, **told) for case in own]
    return cases


if __name__ == "__main__":
    main()
