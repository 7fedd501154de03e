"""Measurement of every figure that the documentation states, beside its target.

    python -m bench.claims                        claims whose command takes 20 minutes at most
    python -m bench.claims --only xl330 'gap-*'   claims or groups by name
    python -m bench.claims --accept               and take the figures into docs/claims.json

Writes build/claims.json and build/claims.html; exit 1 if a target is missed.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import msgspec

from bench.claims.claim_docs import redraw_documents
from bench.claims.claim_page import write_claims_page
from bench.claims.claim_runs import Measurement, chosen_claims, measure_claims
from bench.claims.claim_table import (
    ACCEPTED,
    ROOT,
    AcceptedFigures,
    Claim,
    ClaimFigure,
    read_accepted,
    read_claims,
    read_titles,
)
from firmware_py.console import BAD_INPUT, DONE, NEGATIVE, Progress
from firmware_py.documents import write_document


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.claims", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("--only", nargs="*", default=[], metavar="NAME", help="names or patterns")
    parser.add_argument("--accept", action="store_true", help="renew docs/claims.json and docs")
    parser.add_argument("--draw", action="store_true", help="redraw the docs, measure nothing")
    parser.add_argument("--list", action="store_true", help="list the claims, measure nothing")
    parser.add_argument("--out", type=Path, default=ROOT / "build", help="build")
    args = parser.parse_args(argv)
    claims = read_claims()
    if args.draw:
        return _draw()
    if args.list:
        print(_listed(claims))
        return DONE
    chosen = chosen_claims(claims, args.only)
    if not chosen:
        print(f"no claim is named {' '.join(args.only)}: see --list", file=sys.stderr)
        return BAD_INPUT
    measured = measure_claims(chosen, Progress("claims", len(chosen)).step)
    print(claims_text(measured))
    args.out.mkdir(parents=True, exist_ok=True)
    figures = {m.claim.name: m.figure for m in measured if m.figure}
    write_document(args.out / "claims.json", AcceptedFigures(schema=1, figures=figures))
    print(write_claims_page(measured, read_titles(), args.out / "claims.html"))
    if args.accept:
        accept(figures, claims)
        _draw()
    return NEGATIVE if any(m.met is False for m in measured) else DONE


def accept(figures: dict[str, ClaimFigure], claims: Sequence[Claim]) -> None:
    """Put figures over the accepted ones; figures without a claim are dropped."""
    known = read_accepted() | figures
    kept = {c.name: known[c.name] for c in claims if c.name in known}
    rounded = {
        name: msgspec.structs.replace(f, value=float(f"{f.value:.6g}")) for name, f in kept.items()
    }
    write_document(ACCEPTED, AcceptedFigures(schema=1, figures=rounded))


def _draw() -> int:
    for path in redraw_documents():
        print(f"redrawn: {path.relative_to(ROOT)}", file=sys.stderr)
    return DONE


def _listed(claims: Sequence[Claim]) -> str:
    return "\n".join(
        f"{c.name:34}{c.group:14}{c.minutes:5.0f} min  {c.target:16}{c.command}" for c in claims
    )


def claims_text(measured: Sequence[Measurement]) -> str:
    """Figures beside their targets, for people."""
    word = {True: "met", False: "MISSED", None: ""}
    return "\n".join(
        f"{word[m.met]:7}{m.claim.name:34}"
        f"{m.claim.shown(m.figure) if m.figure else 'no value, ' + m.problem:28}{m.claim.target}"
        for m in measured
    )


if __name__ == "__main__":
    sys.exit(main())
