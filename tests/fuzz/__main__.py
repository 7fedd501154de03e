"""Fuzzer of every reader of files: mutates valid files and judges what each reader makes of them.

An input succeeds if the reader uses it or refuses it in one sentence. Exit 1 if one does not.
"""

import argparse
import sys
import tempfile
from pathlib import Path

from tests.fuzz.cases import add_regression, fuzz, regressions, verdicts_on
from tests.fuzz.readers import every_reader


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0, help="for all readers together")
    parser.add_argument("--inputs", type=int, default=10**9, help="most inputs of each reader")
    parser.add_argument("--seed", type=int, default=0, help="number of the first input")
    parser.add_argument("--only", nargs="+", metavar="READER", help="names as in the table")
    parser.add_argument("--bundle", type=Path, help="of one joint: reads manifest, npz, ONNX, FMU")
    parser.add_argument("--keep", action="store_true", help="keep failing inputs in found/")
    args = parser.parse_args()
    readers = [r for r in every_reader(args.bundle) if not args.only or r.name in args.only]
    with tempfile.TemporaryDirectory(prefix="dropstitch-fuzz-") as scratch:
        return campaign(readers, Path(scratch), args)


def campaign(readers, scratch, args):
    total = failed = 0
    for reader, name, changed in regressions(readers):
        verdict = verdicts_on(reader, [lambda changed=changed: changed], scratch)[0]
        if verdict.failed:
            failed += 1
            print(f"{reader.name}, kept {name}: {verdict.kind}\n{verdict.text}", flush=True)
    readers = [reader for reader in readers if reader.fed]
    print(f"{'reader':12}" + "".join(f"{c:>9}" for c in ("used", "refused", "guarded", "failed")))
    for reader in readers:
        tally = fuzz(reader, scratch, args.seconds / len(readers), args.inputs, args.seed)
        numbers = [tally.counts[c] for c in ("used", "refused", "guarded")]
        row = "".join(f"{n:9}" for n in (*numbers, len(tally.failures)))
        print(f"{reader.name:12}{row}", flush=True)
        for seed, verdict in tally.failures:
            print(f"--- {reader.name}, input {seed}: {verdict.kind}\n{verdict.text}", flush=True)
            if args.keep:
                print(f"kept in {add_regression(reader, seed)}")
        total, failed = total + tally.counts.total(), failed + len(tally.failures)
    print(f"{total} inputs, {failed} failures")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
