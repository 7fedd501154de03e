"""Effects hidden in drawn rigs, and whether the gap workflow names them.

    python -m bench.gap --rigs drawn_1200 drawn_1201 --out build/bench_gap

Each rig has its own structure and equations, and a plant that is identified on it first. Effects
are hidden in it at random, in the rig's own formulation, and its trials are diagnosed: with the
link changed since (default) or the same (--same-link). Rigs from drawn_900 on, test_a and test_b
are for testing: no number of the workflow was set on them.

A name is right where it is that of the hidden effect or a declared look-alike of it. A false alarm
is a gap where nothing is hidden. A data set takes about half a minute on a core, a plant as long. A
rerun does what is missing; delete OUT for results of other code. Prints and writes
OUT/figures.json.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bench.rates import rate
from firmware_py.console import DONE, NEGATIVE
from firmware_py.errors import InputError
from models.gap.training.case_runs import case_results, run_cases
from models.gap.training.cases import hidden_cases
from models.rig.drawn import rig_named

Result = dict[str, Any]


def is_class_right(r: Result) -> bool:
    """Whether a hidden effect is named first, or is a declared look-alike of what is.

    What was named and then taken out again does not count.
    """
    if not r["named"]:
        return False
    turns = zip(r["chosen"], r["look_alikes"], strict=True)
    names, alike = next(turn for turn in turns if r["named"][0] in turn[0])
    right = {e for e in names if e in r["named"]} | {e for effects in alike for e in effects}
    return bool(set(r["case"]["hidden"]) & right)


def gap_figures(results: Sequence[Result]) -> dict[str, Any]:
    """Rates over some results, each with its 95 % interval."""
    possible = [r for r in results if "impossible" not in r]
    of = {k: [r for r in possible if r["case"]["kind"] == k] for k in ("single", "null", "pair")}
    outside = [r for r in possible if r["case"]["kind"] == "outside" and r["separable"]]
    wrong = [
        bool(r["named"]) and not is_class_right(r) and r["verdict"] in ("closed", "reduced")
        for r in of["single"]
    ]
    return {
        "class_right": rate([is_class_right(r) for r in of["single"]]),
        "wrong_and_closed": rate(wrong),
        "false_alarms": rate([r["verdict"] != "no gap" for r in of["null"]]),
        "pairs_both": rate([set(r["case"]["hidden"]) <= set(r["named"]) for r in of["pair"]]),
        "outside_said": rate([r["verdict"] == "not in the catalogue" for r in outside]),
    }


def figures_by_link(results: Sequence[Result]) -> dict[str, Any]:
    """Figures with the link changed since the plant was identified, and with the same link."""
    return {
        "link changed": gap_figures([r for r in results if r["case"]["nuisance"]]),
        "same link": gap_figures([r for r in results if not r["case"]["nuisance"]]),
    }


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
    for name in args.rigs:
        try:
            rig_named(name)
        except InputError as error:
            parser.error(str(error))
    counts = args.singles, 0, args.nulls, args.pairs, args.outside
    drawn = [
        case for rig in args.rigs
        for case in hidden_cases(rig, *counts, args.seed, args.same_link, args.joints)
    ]  # fmt: skip
    failed = run_cases(drawn, args.out)
    figures = figures_by_link(list(case_results(args.out).values()))
    text = json.dumps(figures, indent=1) + "\n"
    (args.out / "figures.json").write_text(text, encoding="utf-8")
    print(text, end="")
    if failed:
        print(f"{failed} cases have no result: see {args.out}/failures", file=sys.stderr)
    return NEGATIVE if failed else DONE


if __name__ == "__main__":
    sys.exit(main())
