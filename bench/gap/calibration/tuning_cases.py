"""Cases for tuning: the benchmark on rigs for tuning, with faint effects among the usual ones.

    python -m bench.gap.calibration.tuning_cases --rigs drawn_159 drawn_160 --same-link --out A
    python -m bench.gap.calibration.answer_model A

`python -m bench.gap` draws usual effects before faint ones, so a short run has none of these, and
probabilities that are fitted to it believe what is faint too little. Here each rig has both, of
different effects. No rig for testing may be among them.
"""

from __future__ import annotations

import argparse
import sys
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from bench.gap.benchmark_run import run_benchmark
from bench.gap.cases import TYPICAL, TYPICAL_OF_TWO_JOINTS, BenchCase, Kind, drawn_case
from models.rig.drawn_rig import rig_purpose

USUAL_SIZE: Final = 1.0
FAINT_SIZE: Final = 0.4
"""Sizes of the effects, as a fraction of what matters (`bench.gap.cases.TYPICAL`)."""


def tuning_cases(
    rig: str,
    usual: int,
    faint: int,
    nulls: int,
    pairs: int,
    outside: int,
    seed: int,
    same_link: bool,
    joints: int = 1,
    effects: Sequence[str] = (),
) -> Iterator[BenchCase]:
    """Draw the cases of one rig.

    `usual`, `faint`: data sets with one effect of either size, each with another effect.
    `nulls`, `pairs`, `outside`: without an effect, with two, and with one that the catalogue is
    denied.
    `same_link`: whether the link is the one that the plant was identified on.
    `effects`: effects to draw from; all of the catalogue where it is empty.
    """
    rng = np.random.default_rng([seed, zlib.crc32(rig.encode())])

    def case(kind: Kind, *hidden: tuple[str, float]) -> BenchCase:
        return drawn_case(rng, kind, hidden, rig, same_link, joints)

    catalogue = list(effects or (TYPICAL_OF_TWO_JOINTS if joints == 2 else TYPICAL))
    names = rng.permutation(catalogue).tolist()
    yield from (case("single", (e, USUAL_SIZE)) for e in names[:usual])
    yield from (case("single", (e, FAINT_SIZE)) for e in names[usual : usual + faint])
    yield from (case("null") for _ in range(nulls))
    for _ in range(pairs):
        first, second = rng.choice(catalogue, 2, replace=False).tolist()
        yield case("pair", (first, USUAL_SIZE), (second, USUAL_SIZE))
    drawn = (str(rng.choice(catalogue)) for _ in range(outside))
    yield from (case("outside", (effect, USUAL_SIZE)) for effect in drawn)


def main() -> None:
    """Draw and run."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
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
    args = parser.parse_args()
    for rig in args.rigs:
        if rig_purpose(rig) == "test":
            parser.error(f"{rig} is for testing: nothing is set on it")
    counts = args.usual, args.faint, args.nulls, args.pairs, args.outside
    links = args.seed, args.same_link, args.joints, args.effects
    cases = [c for rig in args.rigs for c in tuning_cases(rig, *counts, *links)]
    ran = run_benchmark(cases, None, args.out, sealed=False).ran
    if lost := sum(ran.values()) - ran.get("done", 0):
        print(f"{lost} cases have no result: see {args.out}/failures", file=sys.stderr)


if __name__ == "__main__":
    main()
