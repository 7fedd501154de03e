"""Fuzzer of every reader of files: mutates valid files and judges what each reader makes of them.

An input succeeds if the reader uses it or refuses it in one sentence. Exit 1 if one does not.
"""

import argparse
import contextlib
import json
import multiprocessing
import os
import sys
import tempfile
from multiprocessing import connection
from pathlib import Path

from tests.fuzz.campaign_of_inputs import fuzz, keep, kept, verdicts_on
from tests.fuzz.fuzz_readers import every_reader

COLUMNS = ("inputs", "used", "refused", "guarded", "failed")


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0, help="for all readers together")
    parser.add_argument("--inputs", type=int, default=10**9, help="most inputs of each reader")
    parser.add_argument("--seed", type=int, default=0, help="number of the first input")
    parser.add_argument("--only", nargs="+", metavar="READER", help="names as in the table")
    parser.add_argument("--bundle", type=Path, help="of one joint: reads manifest, npz, ONNX, FMU")
    parser.add_argument(
        "--keep", action="store_true", help="keep failing inputs in tests/fuzz/found"
    )
    parser.add_argument("--workers", type=int, default=1, help="readers at one time (default: 1)")
    parser.add_argument("--out", type=Path, help="JSON file for the counts")
    args = parser.parse_args()
    readers = [r for r in every_reader(args.bundle) if not args.only or r.name in args.only]
    with tempfile.TemporaryDirectory(prefix="dropstitch-fuzz-") as scratch:
        return campaign(readers, Path(scratch), args)


def campaign(readers, scratch, args):
    print(
        f"{'reader':12}" + "".join(f"{c:>9}" for c in COLUMNS) + "  peak MB  slowest s", flush=True
    )
    total, failed, rows = 0, 0, {}
    for reader, name, changed in kept(readers):
        verdict = verdicts_on(reader, [lambda changed=changed: changed], scratch)[0]
        if verdict.failed:
            failed += 1
            print(f"{reader.name}, kept {name}: {verdict.kind}\n{verdict.text}", flush=True)
    readers = [reader for reader in readers if reader.fed]
    for reader, tally in tallies(readers, scratch, args):
        count, bad = tally.counts.total(), len(tally.failures)
        row = (count, *(tally.counts[c] for c in COLUMNS[1:-1]), bad)
        print(
            f"{reader.name:12}" + "".join(f"{n:9}" for n in row)
            + f"{tally.peak_bytes / 1e6:9.0f}{tally.slowest_s:11.2f}", flush=True,
        )  # fmt: skip
        rows[reader.name] = dict(zip(COLUMNS, row, strict=True)) | {
            "peak_mb": tally.peak_bytes / 1e6, "slowest_s": tally.slowest_s
        }  # fmt: skip
        for seed, verdict in tally.failures:
            print(f"--- {reader.name}, input {seed}: {verdict.kind}\n{verdict.text}", flush=True)
            if args.keep:
                print(f"kept in {keep(reader, seed)}")
        total, failed = total + count, failed + bad
    print(f"{total} inputs, {failed} failures")
    if args.out:
        args.out.parent.mkdir(parents=True, exist_ok=True)
        peak_mb = max((row["peak_mb"] for row in rows.values()), default=0.0)
        result = {"inputs": total, "failed": failed, "peak_mb": peak_mb, "readers": rows}
        args.out.write_text(json.dumps(result, indent=1), encoding="utf-8")
    return 1 if failed else 0


def tallies(readers, scratch, args):
    """Each reader with its tally, by a process of its own that forks the cases; first come first.

    A reader takes from a second to ten minutes, so none waits for another one.
    """
    seconds = args.workers * args.seconds / len(readers)

    def tally(number, sender):
        own = scratch / str(number)
        own.mkdir()
        with silence():
            sender.send(fuzz(readers[number], own, seconds, args.inputs, args.seed))

    fork = multiprocessing.get_context("fork")
    waiting, running = list(enumerate(readers)), {}
    while waiting or running:
        while waiting and len(running) < args.workers:
            number, reader = waiting.pop(0)
            receiver, sender = fork.Pipe(duplex=False)
            server = fork.Process(target=tally, args=(number, sender))
            server.start()
            sender.close()
            running[receiver] = reader, server
        for receiver in connection.wait(list(running)):
            reader, server = running.pop(receiver)
            yield reader, receiver.recv()
            server.join()


@contextlib.contextmanager
def silence():
    """Nothing of the readers on the terminal; the valid files are read in this process."""
    sys.stdout.flush()
    terminal, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        sys.stdout.flush()
        os.dup2(terminal, 1)
        os.close(terminal)
        os.close(nowhere)


if __name__ == "__main__":
    sys.exit(main())
