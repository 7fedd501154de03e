"""Wrong and right imports: how many are refused or warned with the right cause; the clock's error.

    python -m bench.imports --out build/bench/imports.json

Takes are written from trials of the rig at 0, 1 and 2 kg, with hidden offsets of up to 2 s. Exit 1
if fewer than 38 of 40 wrong imports are told, a right one is refused, or an offset is further than
1 ms from the true one in more than 5 % of the right ones.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

from bench.imports.import_cases import ImportCase, right_cases, wrong_cases
from firmware_py.console import DONE, NEGATIVE, Progress
from firmware_py.motion_config import MotionConfig
from models.__main__ import main as models_main
from models.rig.drawn_rig import rig_named
from models.rig.study_protocol import draw_variation, run_case
from models.rig.trial_case import TrialCase
from models.trials.trial import Trial

TOLD: Final = 0.95
CLOCK_S: Final = 1e-3
PAYLOADS_KG: Final = (0.0, 1.0, 2.0)


def rig_trials(seed: int) -> Iterator[tuple[Trial, float]]:
    """Trials of the rig and the delay of the capture in each."""
    parameters = rig_named("default").changed(
        **{"sensor.marker_noise_m": 0.0, "sensor.mocap_jitter_s": 0.0}
    )  # noise and sampling are those of the written take
    for dof, kind in ((1, "sinusoid"), (2, "sinusoid"), (1, "multisine")):
        for payload_kg in PAYLOADS_KG:
            motion = MotionConfig(
                amplitude_rad=math.radians(30), phase_2_rad=math.radians(90) if dof == 2 else 0.0
            ).with_motion(kind)
            case = TrialCase(motion.motion(dof), payload_kg, trial=1, seed=seed)
            delay_s = draw_variation(parameters, case, case.rng()).parameters[
                "sensor.mocap_delay_s"
            ]
            yield run_case(parameters, case), delay_s


def import_case(case: ImportCase, directory: Path, seed: int) -> dict[str, Any]:
    """Write and import one case; what the command said."""
    arguments = case.take.write(case.trial, directory, seed)
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = models_main(["import", *arguments, "--out", str(directory / "trials"), "--json"])
    said = json.loads(out.getvalue()) if code == 0 else {}
    told = case.cause in err.getvalue() if case.cause else False
    return {
        "case": case.name,
        "exit": code,
        "cause": case.cause,
        "told": told,
        "said": err.getvalue().strip(),
        "offset_s": said.get("offset_s"),
        "offset_error_s": said.get("offset_error_s"),
        "true_offset_s": case.take.offset_s - case.take.epoch_s,
    }


def summarise(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Counts over all cases, and the clock's errors."""
    wrong, right = [r for r in rows if r["cause"]], [r for r in rows if not r["cause"]]
    timed = [r for r in right if r["exit"] == 0]
    errors = np.array([r["offset_s"] - r["true_offset_s"] - r["delay_s"] for r in timed])
    covered = [abs(e) <= r["offset_error_s"] for e, r in zip(errors, timed, strict=True)]
    return {
        "wrong": len(wrong),
        "told": sum(r["told"] for r in wrong),
        "refused_wrong": sum(r["exit"] != 0 for r in wrong),
        "right": len(right),
        "refused_right": sum(r["exit"] != 0 for r in right),
        "warned_right": sum(bool(r["said"]) for r in right),
        "clock_within_1_ms": int(np.sum(np.abs(errors) <= CLOCK_S)),
        "clock_largest_ms": float(1e3 * np.max(np.abs(errors), initial=0.0)),
        "clock_covered": int(sum(covered)),
    }


def main(argv: list[str] | None = None) -> int:
    """Run all cases and print what was told."""
    parser = argparse.ArgumentParser(prog="python -m bench.imports", description=__doc__)
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--count", type=int, default=40, help="right imports (40)")
    parser.add_argument("--out", type=Path, metavar="JSON", help="write every case")
    args = parser.parse_args(argv)
    trials = list(rig_trials(args.seed))
    delays = {trial.name: delay_s for trial, delay_s in trials}
    one, two = trials[1][0], trials[4][0]
    cases = wrong_cases(one, two, args.seed)
    cases += right_cases([trial for trial, _ in trials], args.count, args.seed)
    progress, rows = Progress("imports", len(cases)), []
    with TemporaryDirectory() as directory:
        for k, case in enumerate(cases):
            row = import_case(case, Path(directory) / str(k), args.seed + k)
            rows.append(row | {"delay_s": delays[case.trial.name]})
            progress.step(case.name)
    result = summarise(rows)
    for row in rows:
        if (row["cause"] and not row["told"]) or (not row["cause"] and row["said"]):
            print(f"{row['case']}: exit {row['exit']}: {row['said'] or 'nothing said'}")
    print(json.dumps(result, indent=1))
    if args.out:
        args.out.parent.mkdir(parents=True, exist_ok=True)
        args.out.write_text(json.dumps(result | {"cases": rows}, indent=1))
    good = (
        result["told"] >= TOLD * result["wrong"]
        and result["refused_right"] == 0
        and result["clock_within_1_ms"] >= 0.95 * (result["right"] or 1)
    )
    return DONE if good else NEGATIVE


if __name__ == "__main__":
    sys.exit(main())
