"""Draw mutants by subject, run the subject's tests against each, compare with `fractions.json`.

The exit code is 1 if fewer mutants of a subject are killed than before and than chance explains
(95 %).
"""

from __future__ import annotations

import argparse
import datetime
import json
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

from scipy.stats import fisher_exact

from tests.mutation.forked_runs import Run, ended_runs, import_libraries
from tests.mutation.mutants import draw
from tests.mutation.subjects import ROOT, SUBJECTS

STORED = Path(__file__).with_name("fractions.json")
BASELINE_S = 600.0


def parsed(argv=None):
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__)
    names = [subject.name for subject in SUBJECTS]
    parser.add_argument("--only", nargs="+", metavar="SUBJECT", choices=names, default=names)
    parser.add_argument("--seed", type=int, default=1, help="of the draw (default 1)")
    parser.add_argument("--count", type=int, default=30, help="of each subject (default 30)")
    parser.add_argument("--workers", type=int, default=2, help="processes at a time (default 2)")
    parser.add_argument("--accept", action="store_true", help=f"write {STORED.name}")
    return parser.parse_args(argv)


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def baseline(subjects, workers) -> dict[str, float]:
    """Seconds that each subject's tests take on the code as it is; exit 2 if they fail."""
    say("tests without a mutant")
    runs = [Run(s.pytest_arguments(), ROOT, BASELINE_S, subject=s.name) for s in subjects]
    ended = ended_runs(runs, workers, lambda end: say(f"  {end.run.subject} {end.taken_s:.0f} s"))
    for end in ended:
        if end.result != "survived":
            say(f"{end.output}\n{end.run.subject}: its tests do not pass without a mutant")
            sys.exit(2)
    return {end.run.subject: end.taken_s for end in ended}


def place(mutant) -> str:
    new = "(deleted)" if mutant.kind == "deletion" else mutant.new
    line = f"{mutant.path.relative_to(ROOT)}:{mutant.line}  {mutant.old}  →  {new}"
    return " ".join(line.split())


def fewer_killed(now: dict, before: dict) -> bool:
    """Whether fewer are killed than before and than chance explains (Fisher's exact test, 95 %)."""
    table = [[part["killed"], part["mutants"] - part["killed"]] for part in (now, before)]
    return bool(fisher_exact(table, alternative="less").pvalue < 0.05)


def main(argv=None) -> int:
    options = parsed(argv)
    subjects = [s for s in SUBJECTS if s.name in options.only]
    drawn = {"seed": options.seed, "count": options.count}
    stored = json.loads(STORED.read_text())
    same = drawn.items() <= stored.items()
    if options.accept and len(subjects) < len(SUBJECTS) and not same:
        say(f"--only with --accept: {STORED.name} has another seed or count; use these")
        return 2
    for name, pattern in ((s.name, m) for s in subjects for m in s.modules):
        if not any(ROOT.glob(pattern.lstrip("!"))):
            say(
                f"tests/mutation/subjects.py, {name}: no file matches {pattern}; name its new place"
            )
            return 2
    start_s = time.monotonic()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that runs end with it
    import_libraries()
    taken_s = baseline(subjects, options.workers)
    runs = [Run(s.pytest_arguments(), ROOT, 5 * taken_s[s.name] + 5, mutant, s.name)
            for s in subjects
            for mutant in draw(s.paths(), options.count, options.seed)]  # fmt: skip
    done = iter(range(1, len(runs) + 1))

    def report(end):
        of, mutant = f"{next(done)}/{len(runs)}", place(end.run.mutant)
        say(f"{of} {end.run.subject} {end.result} {end.taken_s:.1f} s  {mutant}")

    ended = ended_runs(runs, options.workers, report)
    commit = subprocess.run(
        ["git", "rev-parse", "--short=8", "HEAD"], cwd=ROOT, capture_output=True, text=True
    ).stdout.strip()
    results, fallen = {}, []
    print("| subject | modules | mutants | killed | of them by time | survived | fraction |")
    print("|---|---|---|---|---|---|---|")
    for subject in subjects:
        count = Counter(end.result for end in ended if end.run.subject == subject.name)
        killed = count["killed"] + count["timeout"]
        mutants = killed + count["survived"]
        print(f"| {subject.name} | {len(subject.paths())} | {mutants} | {killed} | "
              f"{count['timeout']} | {count['survived']} | {killed / mutants:.2f} |")  # fmt: skip
        result = results[subject.name] = {
            "killed": killed, "mutants": mutants, "commit": commit,
            "date": datetime.date.today().isoformat(),
        }  # fmt: skip
        before = stored["subjects"].get(subject.name)
        if same and before and fewer_killed(result, before):
            fallen.append(subject.name)
    print(f"\n{len(ended)} mutants in {time.monotonic() - start_s:.0f} s; these survive:\n")
    for end in ended:
        if end.result == "survived":
            print(f"{end.run.subject}  {place(end.run.mutant)}")
    if options.accept:
        results = {**(stored["subjects"] if same else {}), **results}
        STORED.write_text(json.dumps({**drawn, "subjects": results}, indent=1) + "\n")
        return 0
    print("".join(f"\nfewer are killed than before: {name}" for name in fallen))
    return bool(fallen)


if __name__ == "__main__":
    sys.exit(main())
