"""Benchmark of campaigns.

    python -m bench.campaigns --out build/bench_campaigns
    python -m bench.campaigns --out build/bench_campaigns --only overhead

`overhead`: synthetic cases of 0.5 s on two workers. `engines`: the campaign of docs/campaigns on
processes, and on a local dask cluster of two workers of which one is killed three times. Leaves
OUT/campaigns.json.
"""

from __future__ import annotations

import argparse
import json
import shutil
from pathlib import Path

from bench.campaigns.engine_figures import engines_side_by_side
from bench.campaigns.overhead_figures import overhead_by_engine

SPEC = Path("docs/campaigns/payload-and-loss.toml")


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--out", type=Path, required=True, help="directory of results; what it held is removed")
    add("--only", choices=("overhead", "engines"), help="one part")
    add("--spec", type=Path, default=SPEC, help="campaign of the part engines")
    add("--cases", type=int, default=60, help="synthetic cases of each engine")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    path = args.out / "campaigns.json"
    found = json.loads(path.read_text()) if path.exists() else {}
    if args.only in (None, "overhead"):
        found["overhead"] = overhead_by_engine(args.cases, _fresh(args.out / "overhead"))
    if args.only in (None, "engines"):
        found["engines"] = engines_side_by_side(args.spec, _fresh(args.out / "engines"))
    path.write_text(json.dumps(found, indent=1) + "\n")
    print(json.dumps(found, indent=1))


def _fresh(directory: Path) -> Path:
    shutil.rmtree(directory, ignore_errors=True)
    return directory


if __name__ == "__main__":
    main()
