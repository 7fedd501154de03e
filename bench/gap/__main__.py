"""Benchmark of the gap workflow.

    python -m bench.gap --plant build/plant.json --out build/bench_gap

Resumable: one result file per case, named by its hash; a rerun does what is missing.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
from collections.abc import Iterable
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from pathlib import Path

from bench.gap.case_run import run_bench_case
from bench.gap.cases import BenchCase, draw_cases
from bench.gap.score_summary import benchmark_figures, confusion_matrix_svg
from firmware_py.console import Progress


def run_benchmark(
    cases: Iterable[BenchCase], plant: Path, out: Path, executor: Executor | None = None
) -> None:
    """Run cases on anything with `.submit`: processes by default, dask's or submitit's executor.

    Parameters
    ----------
    cases : iterable of BenchCase
        Drawn by `draw_cases`.
    plant : Path
        Identified without effects.
    out : Path
        Directory of the result files.
    executor : Executor, optional
        Anything with `.submit`; two processes by default.
    """
    out.mkdir(parents=True, exist_ok=True)
    left = [c for c in cases if not (out / f"{c.key}.json").exists()]
    left.sort(key=lambda c: c.key)  # a run that is stopped leaves a fair sample
    progress = Progress("bench.gap", len(left))
    os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
    pool = executor or ProcessPoolExecutor(2, multiprocessing.get_context("spawn"))
    try:
        futures = {pool.submit(run_bench_case, case, str(plant), str(out)): case for case in left}
        for future in as_completed(futures):
            future.result()
            progress.step(futures[future].kind)
    finally:
        if executor is None:
            pool.shutdown(cancel_futures=True)


def main() -> None:
    """Draw, run, summarise."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plant", type=Path, required=True, help="identified without effects")
    parser.add_argument("--out", type=Path, required=True, help="directory of results")
    parser.add_argument("--singles", type=int, default=4, help="cases of each effect and size")
    parser.add_argument("--nulls", type=int, default=150, help="data sets without an effect")
    parser.add_argument("--pairs", type=int, default=30, help="data sets with two effects")
    parser.add_argument("--outside", type=int, default=20, help="effect denied to the catalogue")
    parser.add_argument("--seed", type=int, default=0, help="of the draw")
    args = parser.parse_args()
    cases = draw_cases(args.singles, args.nulls, args.pairs, args.outside, args.seed)
    run_benchmark(cases, args.plant, args.out)
    figures = benchmark_figures(args.out)
    (args.out / "summary").mkdir(exist_ok=True)
    (args.out / "summary" / "figures.json").write_text(json.dumps(figures, indent=1) + "\n")
    (args.out / "summary" / "confusion.svg").write_text(confusion_matrix_svg(args.out))
    print(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
