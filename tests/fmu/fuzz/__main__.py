"""Runner of the fuzzer: `python -m tests.fmu.fuzz --seconds 600`.

Prints one line of JSON: calls made and calls that returned OK, of both versions of FMI together.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.fmu.fuzz.fuzzer import build_fuzzer, fuzz
from tests.fmu.toy import pendulum


def main() -> int:
    """Fuzz both versions of FMI, half of the time each; 1 where a sanitizer or a rule objects."""
    total = {"calls": 0, "accepted": 0}
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--calls", type=int, default=2**62, help="most calls")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    for fmi in (2, 3):
        with TemporaryDirectory() as directory:
            program = build_fuzzer(pendulum(), fmi, Path(directory))
            result = fuzz(program, seed=args.seed, seconds=args.seconds / 2, calls=args.calls // 2)
        total["calls"] += result.calls
        total["accepted"] += result.accepted
        if result.objection:
            print(result.objection, file=sys.stderr)
            return 1
    print(json.dumps(total))
    return 0


if __name__ == "__main__":
    sys.exit(main())
