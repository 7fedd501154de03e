"""Effects hidden in drawn rigs, and whether the gap workflow names them.

    python -m bench.gap --rigs drawn_1200 drawn_1201 --out build/bench_gap

Each rig has its own structure and equations, and a plant that is identified on it first. Effects
are hidden in it at random, in the rig's own formulation, and its trials are diagnosed: with the
link changed since (default) or the same (--same-link). Rigs from drawn_900 on, test_a and test_b
are for testing: no number of the workflow was set on them.

A name is right where it is that of the hidden effect or a declared look-alike of it. A false alarm
is a gap where nothing is hidden. A data set takes one to two minutes on a core, a plant one. A
rerun does what is missing; delete OUT for results of other code. Prints the figures and writes them
to OUT/figures.json.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

from firmware_py.core.console import DONE, NEGATIVE
from firmware_py.core.errors import InputError
from models.gap.training.case_runs import DataSetRecord, effects_of, records_of, run_cases
from models.gap.training.cases import hidden_cases
from models.gap.training.fit import calibration_table
from models.rig.drawn import rig_named


def rate(rows: Sequence[bool]) -> dict[str, Any]:
    """Fraction of true rows, its Clopper-Pearson 95 % interval, and the number of rows."""
    if not rows:
        return {"of": 0}
    interval = binomtest(sum(rows), len(rows)).proportion_ci(0.95, method="exact")
    return {
        "fraction": sum(rows) / len(rows),
        "interval": [float(interval.low), float(interval.high)],
        "of": len(rows),
    }


def is_class_right(record: DataSetRecord) -> bool:
    """Whether the first name is a hidden effect, or has one among its declared look-alikes."""
    if not record.named:
        return False
    first, *_ = record.named
    alike = (c for candidates in record.look_alikes[first] for c in candidates)
    return bool(effects_of([first, *alike]) & set(record.case.hidden))


def is_wrong(record: DataSetRecord) -> bool:
    """Whether another effect than the hidden one passes for what was missing."""
    return (
        bool(record.named)
        and not is_class_right(record)
        and record.verdict in ("closed", "reduced")
    )


def gap_figures(records: Sequence[DataSetRecord]) -> dict[str, Any]:
    """Rates over some records, each with its 95 % interval."""
    of = {
        kind: [r for r in records if not r.impossible and r.case.kind == kind]
        for kind in ("single", "null", "pair", "outside")
    }
    return {
        "class_right": rate([is_class_right(r) for r in of["single"]]),
        "wrong_and_closed": rate([is_wrong(r) for r in of["single"]]),
        "false_alarms": rate([r.verdict != "no gap" for r in of["null"]]),
        "pairs_both": rate([set(r.case.hidden) <= effects_of(r.named) for r in of["pair"]]),
        "outside_said": rate(
            [r.verdict == "not in the catalogue" for r in of["outside"] if r.separable]
        ),
    }


def figures_by_link(records: Sequence[DataSetRecord]) -> dict[str, Any]:
    """Figures with the link changed since the plant was identified, and with the same link."""
    return {
        "link changed": gap_figures([r for r in records if r.case.nuisance]),
        "same link": gap_figures([r for r in records if not r.case.nuisance]),
    }


def calibration(records: Sequence[DataSetRecord]) -> str:
    """How often names are right, by their probability, where the trials can tell."""
    rows = [
        (r.answers.catalogue, r.best_is_right)
        for r in records
        if r.named and r.answers is not None and r.separable
    ]
    return calibration_table(np.array([p for p, _ in rows]), [right for _, right in rows])


def main(argv: Sequence[str] | None = None) -> int:
    """Draw, run, summarise."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.gap", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    add = parser.add_argument
    add("--rigs", nargs="+", required=True, metavar="NAME", help="drawn_K, default, test_a, …")
    add("--out", type=Path, required=True, help="directory of results")
    add("--singles", type=int, default=6, help="data sets of each rig with one effect")
    add("--nulls", type=int, default=1, help="data sets without an effect")
    add("--pairs", type=int, default=1, help="data sets with two effects")
    add("--outside", type=int, default=0, help="data sets with an effect denied to the catalogue")
    add("--same-link", action="store_true", help="the link that the plant was identified on")
    add("--joints", type=int, choices=(1, 2), default=1, help="driven joints")
    add("--seed", type=int, default=0, help="of the draw")
    args = parser.parse_args(argv)
    counts = args.singles, 0, args.nulls, args.pairs, args.outside
    try:
        for name in args.rigs:
            rig_named(name)
    except InputError as error:
        parser.error(str(error))
    cases = [
        case for rig in args.rigs
        for case in hidden_cases(rig, *counts, args.seed, args.same_link, args.joints)
    ]  # fmt: skip
    failed = run_cases(cases, args.out)
    records = records_of(cases, args.out)
    text = json.dumps(figures_by_link(records), indent=1) + "\n"
    (args.out / "figures.json").write_text(text, encoding="utf-8")
    print(text + calibration(records))
    if failed:
        print(f"{failed} jobs failed: see {args.out}/failures", file=sys.stderr)
    return NEGATIVE if failed else DONE


if __name__ == "__main__":
    sys.exit(main())
