"""Draw mutants by subject, run the subject's tests against each, compare with `fractions.json`."""

from __future__ import annotations

import argparse
import datetime
import json
import subprocess
import sys
import time
from pathlib import Path

from scipy.stats import fisher_exact

from tests.mutation.forked_runs import Ended, Run, ended_runs, import_libraries
from tests.mutation.mutants import draw
from tests.mutation.subjects import ROOT, SUBJECTS

STORED = Path(__file__).with_name("fractions.json")
BASELINE_S = 600.0
SIGNIFICANCE = 0.05


def parsed(argv=None):
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__)
    names = [subject.name for subject in SUBJECTS]
    parser.add_argument("--only", nargs="+", metavar="SUBJECT", choices=names, default=names)
    parser.add_argument("--seed", type=int, default=1, help="of the draw (default 1)")
    parser.add_argument("--count", type=int, default=300, help="mutants of all subjects together")
    parser.add_argument("--workers", type=int, default=2, help="processes at a time (default 2)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the result as JSON")
    parser.add_argument("--accept", action="store_true", help=f"write {STORED.name}")
    return parser.parse_args(argv)


def said(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def baseline(subjects, workers) -> dict[str, float]:
    """Seconds that each subject's tests take on the code as it is; exit 2 if they fail."""
    said("tests without a mutant")
    runs = [Run(s.tests, ROOT, BASELINE_S, subject=s.name) for s in subjects]
    ended = ended_runs(runs, workers, lambda end: said(f"  {end.run.subject}: {end.taken_s:.0f} s"))
    for end in ended:
        if end.result != "survived":
            tests = " ".join(end.run.tests)
            said(f"{end.output}\nthe tests of {end.run.subject} do not pass as they are: {tests}")
            sys.exit(2)
    return {end.run.subject: end.taken_s for end in ended}


def place(mutant) -> str:
    path = mutant.path.relative_to(ROOT)
    new = " ".join(mutant.new.split()) if mutant.kind != "deletion" else "(deleted)"
    return f"{path}:{mutant.line}  {' '.join(mutant.old.split())}  →  {new}"


def keys(results: list[Ended], *kinds: str) -> list[str]:
    return sorted(end.run.mutant.key for end in results if end.result in kinds)


def losses(now: dict, before: dict) -> tuple[list[str], str]:
    """Mutants that were killed and are no longer, and why that is a fall, or ""."""
    lost = sorted(set(before["killed"]) & set(now["survived"]))
    won = set(before["survived"]) & set(now["killed"])
    if len(lost) - len(won) > 1:
        return lost, f"{len(lost)} mutants that were killed survive"
    table = [[len(part["killed"]), len(part["survived"])] for part in (now, before)]
    if fisher_exact(table, alternative="less").pvalue < SIGNIFICANCE:
        return lost, "fewer are killed than chance explains"
    return lost, ""


def main(argv=None) -> int:
    options = parsed(argv)
    subjects = [s for s in SUBJECTS if s.name in options.only]
    each = options.count // len(SUBJECTS)
    stored = json.loads(STORED.read_text()) if STORED.exists() else {"subjects": {}}
    comparable = (options.seed, options.count) == (stored.get("seed"), stored.get("count"))
    if options.accept and options.only != [s.name for s in SUBJECTS] and not comparable:
        said(
            "--accept of some subjects needs the seed and the count of the others; leave out --only"
        )
        return 2
    start_s = time.monotonic()
    import_libraries()
    unmutated_s = baseline(subjects, options.workers)
    runs = [
        Run(s.tests, ROOT, 5 * unmutated_s[s.name] + 5, mutant, s.name)
        for s in subjects for mutant in draw(s.paths(), each, options.seed)
    ]  # fmt: skip
    done = 0

    def report(end):
        nonlocal done
        done += 1
        mutant = place(end.run.mutant)
        said(f"{done}/{len(runs)} {end.run.subject} {end.result} {end.taken_s:.1f} s  {mutant}")

    ended = ended_runs(runs, options.workers, report)
    commit = subprocess.run(
        ["git", "rev-parse", "--short=8", "HEAD"], cwd=ROOT, capture_output=True, text=True
    ).stdout.strip()
    results, falls = {}, []
    print("| subject | modules | mutants | killed | of them by time | survived | fraction |")
    print("|---|---|---|---|---|---|---|")
    for subject in subjects:
        of = [end for end in ended if end.run.subject == subject.name]
        result = {
            "fraction": round(len(keys(of, "killed", "timeout")) / len(of), 3),
            "n": len(of),
            "date": datetime.date.today().isoformat(),
            "commit": commit,
            "killed": keys(of, "killed", "timeout"),
            "survived": keys(of, "survived"),
        }
        results[subject.name] = result
        print(f"| {subject.name} | {len(subject.paths())} | {len(of)} | {len(result['killed'])} | "
              f"{len(keys(of, 'timeout'))} | {len(result['survived'])} | {result['fraction']:.2f} |")  # fmt: skip
        if comparable and subject.name in stored["subjects"]:
            lost, why = losses(result, stored["subjects"][subject.name])
            falls += [f"{subject.name}: {why}"] if why else []
            for end in of:
                if end.run.mutant.key in lost:
                    said(f"no longer killed: {place(end.run.mutant)}")
    print(f"\n{len(ended)} mutants in {time.monotonic() - start_s:.0f} s; these survive:\n")
    for end in ended:
        if end.result == "survived":
            print(f"{end.run.subject}  {place(end.run.mutant)}")
    document = {"seed": options.seed, "count": options.count, "subjects": results}
    if options.out:
        options.out.parent.mkdir(parents=True, exist_ok=True)
        options.out.write_text(json.dumps(document, indent=1) + "\n")
    if options.accept:
        kept = stored["subjects"] if comparable else {}
        document["subjects"] = {**kept, **results}
        STORED.write_text(json.dumps(document, indent=1) + "\n")
        return 0
    for fall in falls:
        print(f"fallen: {fall}")
    return bool(falls)


if __name__ == "__main__":
    sys.exit(main())
