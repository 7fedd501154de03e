"""Run many cases, over a grid or a random draw of settings, on this machine or a cluster.

SPEC.toml names the kind of the cases (sil, fmu, gap, rig) and their axes. Writes to OUT: results/
(one file per case), failures/ (with logs), summary.csv, campaign.json, report.html and costs.csv.
A second run resumes: it runs the cases whose results are missing or damaged, or that failed.
Exit 0: every case has a result. Exit 1: at least one has none.
"""

from __future__ import annotations

import argparse
import os
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from firmware_py.core.console import DONE, NEGATIVE, emit
from firmware_py.core.errors import InputError

if TYPE_CHECKING:
    from hil.campaign.campaign_cases import CampaignCase, CaseMaker
    from hil.campaign.campaign_spec import CampaignSpec
    from hil.campaign.engines.engine import Engine
    from hil.campaign.result_store import ResultStore

EXAMPLE = "dropstitch campaign docs/campaigns/payload-and-loss.toml --out build/campaign"
EXECUTORS = ("processes", "dask", "submitit")


def configure(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("spec", type=Path, metavar="SPEC.toml", help="see docs/campaigns.md")
    add("--out", type=Path, required=True, metavar="DIR", help="directory for the results")
    add(
        "--executor", choices=EXECUTORS, default="processes",
        help="processes of this machine, a dask cluster, or jobs of a queue (default: processes)",
    )  # fmt: skip
    add("--workers", type=int, metavar="N", help="processes or jobs (default: the processors here)")
    add("--scheduler", metavar="ADDRESS", help="with dask: tcp://HOST:8786")
    add("--cluster", metavar="NAME", help="with submitit: slurm, or local to try it here")
    add(
        "--parameter", action="append", default=[], metavar="NAME=VALUE",
        help="with submitit: of a job, like slurm_partition=short; repeatable",
    )  # fmt: skip
    add(
        "--dry-run", action="store_true",
        help="run only a few cases, and say what all would take",
    )  # fmt: skip
    add(
        "--cases",
        type=int,
        nargs="+",
        metavar="N",
        help="with --dry-run: for so many cases instead",
    )


def run(args: argparse.Namespace) -> int:
    from hil.campaign.campaign_cases import CaseMaker
    from hil.campaign.campaign_spec import configurations, read_spec
    from hil.campaign.kinds.case_kind import load_kind
    from hil.campaign.result_store import ResultStore

    _check(args)
    spec = read_spec(args.spec)
    kind = load_kind(spec.kind)
    maker = CaseMaker(kind, spec.kind, args.out / "shared")
    cases = maker.cases(configurations(spec), str(args.spec))
    store = ResultStore(args.out)
    with store.locked():
        (args.out / "campaign.toml").write_bytes(args.spec.read_bytes())
        _say_other_code(store, maker.code)
        if args.dry_run:
            return _plan(args, cases, maker, store)
        return _run_all(args, spec, cases, maker, store)


def _check(args: argparse.Namespace) -> None:
    if args.workers is not None and not 1 <= args.workers <= 10_000:
        raise InputError("--workers", f"is {args.workers}", "give 1 to 10000")
    for option, owner in (
        ("scheduler", "dask"),
        ("cluster", "submitit"),
        ("parameter", "submitit"),
    ):
        if getattr(args, option) and args.executor != owner:
            raise InputError(f"--{option}", f"is of --executor {owner}", "add that")
    if args.executor == "dask" and not args.scheduler:
        raise InputError(
            "--executor dask", "needs the address of a scheduler", "add --scheduler tcp://HOST:8786"
        )
    if args.cases and (not args.dry_run or min(args.cases) < 1):
        raise InputError("--cases", "is for --dry-run, 1 or more", "add --dry-run")


def _engine(args: argparse.Namespace) -> Engine:
    workers = args.workers or os.cpu_count() or 1
    if args.executor == "dask":
        from hil.campaign.engines.dask_engine import DaskEngine

        return DaskEngine(args.scheduler)
    if args.executor == "submitit":
        from hil.campaign.engines.submitit_engine import SubmititEngine

        pairs = [p.partition("=") for p in args.parameter]
        parameters = {name: value for name, _, value in pairs}
        return SubmititEngine(workers, args.out / "submitit", args.cluster, parameters)
    from hil.campaign.engines.process_engine import ProcessEngine

    return ProcessEngine(workers, args.out / "logs")


def _run_all(
    args: argparse.Namespace,
    spec: CampaignSpec,
    cases: list[CampaignCase],
    maker: CaseMaker,
    store: ResultStore,
) -> int:
    from hil.campaign.campaign_document import campaign_document, describe_campaign_document
    from hil.campaign.campaign_page import write_campaign_page
    from hil.campaign.campaign_run import run_campaign_cases
    from hil.campaign.campaign_summary import write_summary

    real_time = any(maker.kind.in_real_time(case.config) for case in cases)
    if real_time and args.executor == "processes" and args.workers != 1:
        raise InputError(
            "line", "keeps real time, and workers would disturb each other", "add --workers 1"
        )
    counts = run_campaign_cases(cases, maker, store, _engine(args))
    write_summary(cases, store, args.out / "summary.csv")
    document = campaign_document(spec, maker, counts, cases, store)
    document.write(args.out / "campaign.json")
    write_campaign_page(document, spec, maker.kind, cases, store, args.out / "report.html")
    emit(args, msgspec.to_builtins(document), describe_campaign_document(document, args.out))
    return DONE if document.states.get("done", 0) == len(cases) else NEGATIVE


def _plan(
    args: argparse.Namespace, cases: list[CampaignCase], maker: CaseMaker, store: ResultStore
) -> int:
    """Estimate the cost from earlier cases, or from a few that run now; their results count."""
    from hil.campaign.campaign_run import run_campaign_cases
    from hil.campaign.cost_plan import (
        SAMPLE,
        cost_plan,
        describe_plan,
        rows_of_code,
        worker_start_s,
    )
    from hil.campaign.engines.process_engine import ProcessEngine

    costs = rows_of_code(store.read_costs(), maker.code)
    if len(costs) < SAMPLE:
        apart = cases[:: max(len(cases) // SAMPLE, 1)][:SAMPLE]
        print(f"measuring {len(apart)} of {len(cases)} cases", file=sys.stderr)
        run_campaign_cases(apart, maker, store, ProcessEngine(1, args.out / "logs"))
        costs = rows_of_code(store.read_costs(), maker.code)
    workers, start_s = args.workers or os.cpu_count() or 1, worker_start_s(maker.module)
    plans = [
        cost_plan(maker.kind.name, costs, count, workers, start_s, _command(args, workers))
        for count in args.cases or [len(cases)]
    ]
    emit(
        args,
        {"plans": [msgspec.to_builtins(plan) for plan in plans]},
        "\n".join(map(describe_plan, plans)),
    )
    return DONE


def _command(args: argparse.Namespace, workers: int) -> str:
    words = ["dropstitch", "campaign", str(args.spec), "--out", str(args.out)]
    words += ["--executor", args.executor]
    words += ["--scheduler", args.scheduler] if args.scheduler else ["--workers", str(workers)]
    words += ["--cluster", args.cluster] if args.cluster else []
    words += [w for p in args.parameter for w in ("--parameter", p)]
    return shlex.join(words)


def _say_other_code(store: ResultStore, code: str) -> None:
    """Warn if the directory holds results of an earlier version of the code, which do not count."""
    path = store.directory / "code.txt"
    before = path.read_text(encoding="utf-8").strip() if path.exists() else code
    if before != code:
        print(
            f"the code has changed since the last run ({before} to {code}): its results do not "
            "count",
            file=sys.stderr,
        )
    path.write_text(code + "\n", encoding="utf-8")
