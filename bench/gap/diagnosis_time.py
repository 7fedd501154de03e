"""Time of one diagnosis of ten trials by the whole catalogue, as the command line runs it.

    make build/plant.json
    python -m bench.gap.diagnosis_time --plant build/plant.json --out build/diagnosis_time

Five payloads, two repetitions of each, with one joint and with two; nothing hidden, a clear effect,
a faint one, and a pair. It is wall time with the start of the interpreter: run nothing beside it.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Final

from firmware_py.console import Progress

HIDDEN: Final[tuple[tuple[str, ...], ...]] = (
    (),
    ("backlash=0.006",),
    ("creep=0.2",),
    ("stiffness_softening=0.15", "dead_time=0.02"),
)
SEED: Final = 21


def diagnosis_s(plant: Path, joints: int, hidden: tuple[str, ...], out: Path) -> float:
    """Wall time of `python -m models gap` on ten trials of the rig."""
    trials = out / "trials"
    options = [option for effect in hidden for option in ("--hide", effect)]
    command = ["simulate", "--out", str(trials), "--dof", str(joints), "--seed", str(SEED)]
    _models([*command, *options])
    start_s = time.perf_counter()
    _models(["gap", str(trials), "--plant", str(plant), "--out", str(out / "gap")])
    return time.perf_counter() - start_s


def _models(arguments: list[str]) -> None:
    done = subprocess.run([sys.executable, "-m", "models", *arguments], stdout=subprocess.DEVNULL)
    if done.returncode not in (0, 1):  # 1: the missing effect is not in the catalogue
        raise subprocess.CalledProcessError(done.returncode, arguments)


def main() -> None:
    """Measure, write, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--plant", type=Path, required=True, help="identified on the rig")
    parser.add_argument("--out", type=Path, required=True, help="directory of trials and results")
    args = parser.parse_args()
    figures: dict[str, object] = {}
    progress = Progress("bench.gap.diagnosis_time", 2 * len(HIDDEN))
    for joints in (1, 2):
        times_s = {}
        for hidden in HIDDEN:
            name = " + ".join(hidden) or "nothing hidden"
            place = args.out / f"{joints}_{len(times_s)}"
            times_s[name] = round(diagnosis_s(args.plant, joints, hidden, place), 1)
            progress.step(f"{joints} joint(s), {name}: {times_s[name]} s")
        figures[f"joints_{joints}"] = {"each_s": times_s, "most_s": max(times_s.values())}
    (args.out / "times.json").write_text(json.dumps(figures, indent=1), encoding="utf-8")
    print(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
