"""Run many cases, over a grid or a random draw of settings, on this machine or a cluster.

SPEC.toml names the kind of the cases (sil, fmu, gap, rig) and their axes. Writes to OUT: results/
(one file per case), failures/ (with logs), summary.csv, campaign.json, report.html and costs.csv.
A second run resumes: it runs the cases whose results are missing or damaged, or that failed.
Exit 0: every case has a result. Exit 1: at least one has none.
"""

from __future__ import annotations

import argparse
import os
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from firmware_py.core.console import DONE, NEGATIVE, emit
from firmware_py.core.documents import write_document
from firmware_py.core.errors import InputError
from firmware_py.core.output_files import locked_directory

if TYPE_CHECKING:
    from hil.campaign.executors import Workers

EXAMPLE = "dropstitch campaign docs/campaigns/payload-and-loss.toml --out build/campaign"
EXECUTORS = ("processes", "dask")


def configure(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("spec", type=Path, metavar="SPEC.toml", help="see docs/campaigns.md")
    add("--out", type=Path, required=True, metavar="DIR", help="directory for the results")
    add(
        "--executor", choices=EXECUTORS, default="processes",
        help="processes of this machine, or a dask cluster (default: processes)",
    )  # fmt: skip
    add("--workers", type=int, metavar="N", help="workers here (default: the processors)")
    add(
        "--scheduler", metavar="ADDRESS",
        help="with dask: of your cluster, tcp://HOST:8786 (default: a cluster of this machine)",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    from hil.campaign.cases import CaseMaker
    from hil.campaign.executors import run_cases
    from hil.campaign.kinds.case_kind import load_kind
    from hil.campaign.page import write_campaign_page
    from hil.campaign.specification import configurations, read_spec
    from hil.campaign.store import ResultStore
    from hil.campaign.summary import (
        campaign_document,
        describe_campaign,
        summary_rows,
        write_summary,
    )

    if args.workers is not None and not 1 <= args.workers <= 10_000:
        raise InputError("--workers", f"is {args.workers}", "give 1 to 10000")
    if args.scheduler and args.executor != "dask":
        raise InputError("--scheduler", "is of --executor dask", "add that")
    spec = read_spec(args.spec)
    maker = CaseMaker(*load_kind(spec.kind), args.out / "shared")
    cases = maker.cases(configurations(spec), str(args.spec))
    if any(case.options.in_real_time for case in cases):
        _check_alone(args)
    store = ResultStore(args.out)
    with locked_directory(store.directory):
        (args.out / "campaign.toml").write_bytes(args.spec.read_bytes())
        last_run = run_cases(cases, maker, store, _workers(args))
        rows = summary_rows(cases, store)
        document = campaign_document(spec, maker, rows, last_run)
        write_summary(rows, args.out / "summary.csv")
        write_document(args.out / "campaign.json", document)
        write_campaign_page(document, spec, maker.kind, rows, args.out / "report.html")
    emit(args, msgspec.to_builtins(document), describe_campaign(document, args.out))
    return DONE if document.states.get("done", 0) == len(cases) else NEGATIVE


def _workers(args: argparse.Namespace) -> AbstractContextManager[Workers]:
    from hil.campaign.executors import dask_workers, process_workers

    count = args.workers or os.cpu_count() or 1
    if args.executor == "dask":
        return dask_workers(args.scheduler, count)
    return process_workers(count, args.out / "logs")


def _check_alone(args: argparse.Namespace) -> None:
    if args.executor == "dask":
        raise InputError(
            "line", "keeps real time, and workers of a cluster are shared with other programs",
            'set line = "virtual", or take --executor processes --workers 1',
        )  # fmt: skip
    if args.workers != 1:
        raise InputError(
            "line", "keeps real time, and workers would disturb each other", "add --workers 1"
        )
