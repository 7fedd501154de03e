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
from collections.abc import Iterable
from pathlib import Path

from bench.gap.bench_kind import KIND, MODULE, bench_configuration, cases_of_run
from bench.gap.cases import DEFAULT_RIG, BenchCase, draw_cases, mixed_cases
from bench.gap.rig_plants import plant_of_rig
from bench.gap.scores.rig_table import rig_table_text
from bench.gap.scores.summary_files import write_bench_summary
from firmware_py.errors import InputError
from hil.campaign.campaign_cases import CaseMaker
from hil.campaign.campaign_run import RunCounts, run_campaign_cases
from hil.campaign.engines.engine import Engine
from hil.campaign.engines.process_engine import ProcessEngine
from hil.campaign.result_store import ResultStore
from models.rig.drawn_rig import rig_named
from models.rig.rig_structure import named_structures


def run_benchmark(
    cases: Iterable[BenchCase],
    plant: Path | None,
    out: Path,
    engine: Engine | None = None,
    sealed: bool = True,
) -> RunCounts:
    """Run cases that have no valid result.

    Parameters
    ----------
    cases : iterable of BenchCase
        Drawn by `draw_cases`.
    plant : Path or None
        Identified without effects; None for one of each case's own rig.
    out : Path
        Directory of the results.
    engine : Engine, optional
        Of `hil.campaign.engines`; two processes by default.
    sealed : bool
        Whether improved plants are tested on sealed trials.
    """
    wanted, store = list(cases), ResultStore(out)
    robots = sorted({(c.rig, c.joints) for c in wanted})
    plants = {(r, joints): plant or plant_of_rig(r, out / "plants", joints) for r, joints in robots}
    maker = CaseMaker(KIND, MODULE, store.shared)
    made = maker.cases(
        (bench_configuration(c, plants[c.rig, c.joints], sealed) for c in wanted), "bench.gap"
    )
    made.sort(key=lambda c: c.key)  # a run that is stopped leaves a fair sample
    with store.locked():
        return run_campaign_cases(made, maker, store, engine or ProcessEngine(2, out / "logs"))


def main() -> None:
    """Draw, run, summarise."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--plant", type=Path, help="identified on the default rig without effects")
    add(
        "--rigs",
        nargs="+",
        default=[],
        metavar="NAME",
        help="rigs, each with a plant of its own: drawn_K, " + ", ".join(named_structures()),
    )
    add("--out", type=Path, required=True, help="directory of results")
    add("--singles", type=int, default=4, help="cases of each effect and size")
    add("--nulls", type=int, default=150, help="data sets without an effect")
    add("--pairs", type=int, default=30, help="data sets with two effects")
    add("--outside", type=int, default=20, help="effect denied to the catalogue")
    add("--most", type=int, help="at most so many cases of each rig, of all kinds in turn")
    add("--seed", type=int, default=0, help="of the draw")
    add("--joints", type=int, choices=(1, 2), default=1, help="driven joints")
    add("--same-link", action="store_true", help="the link that the plant was identified on")
    add("--like", type=Path, metavar="DIR", help="the cases of another run, by its results")
    add("--no-sealed", action="store_true", help="leave out the test on sealed trials")
    add("--scheduler", metavar="ADDRESS", help="of a dask cluster, in place of two processes")
    args = parser.parse_args()
    if sum(map(bool, (args.plant, args.rigs, args.like))) != 1:
        parser.error("give one of --plant, --rigs and --like")
    for name in args.rigs:
        try:
            rig_named(name)
        except InputError as error:
            parser.error(str(error))
    engine = None
    if args.scheduler:
        from hil.campaign.engines.dask_engine import DaskEngine

        engine = DaskEngine(args.scheduler)
    counts = run_benchmark(_cases(args), args.plant, args.out, engine, not args.no_sealed)
    if lost := sum(counts.ran.values()) - counts.ran.get("done", 0):
        print(f"{lost} cases have no result: see {args.out}/failures", file=sys.stderr)
    figures, by_rig = write_bench_summary(args.out)
    print(json.dumps(figures, indent=1) if args.plant else rig_table_text(by_rig))


def _cases(args: argparse.Namespace) -> list[BenchCase]:
    """Cases of the command line."""
    if args.like:
        return cases_of_run(args.like)
    cases: list[BenchCase] = []
    for rig in args.rigs or [DEFAULT_RIG]:
        counts = args.singles, args.nulls, args.pairs, args.outside
        own = list(draw_cases(*counts, args.seed, rig, args.same_link, args.joints))
        cases += own if args.most is None else mixed_cases(own, args.most)
    return cases


if __name__ == "__main__":
    main()
