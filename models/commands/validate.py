"""Validation of trials before anything is fitted to them.

Every trial of the directory is checked as an import is: rest pose against the nominal link, names,
signs, joints, clock, rest rows; then what they hold together: size of the link, trials to test on,
joints that move apart. With --plant, the current over the payloads shows their unit and the torque
constant. Trials of another plant are read and their columns checked.

Exit 0 passed or warned, 1 a trial would be refused.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from firmware_py.core.console import DONE, NEGATIVE, emit
from models.plant.plant import read_plant
from models.trials.checks.payloads import judge_payload_unit
from models.trials.checks.trials import check_trial, check_trials
from models.trials.checks.verdict import ImportVerdict, write_verdict
from models.trials.files import read_trials

EXAMPLE = "dropstitch validate trials --out build/validated"


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("trials", type=Path, metavar="DIR", help="directory of trials")
    parser.add_argument(
        "--plant",
        type=Path,
        metavar="PLANT",
        help="plant of these trials: its weight and torque constant show the payloads' unit",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="write a page for each trial")


def run(args: argparse.Namespace) -> int:
    plant = read_plant(args.plant) if args.plant else None
    trials = read_trials(args.trials, plant.signals if plant else None)
    if plant and plant.load != "link":
        emit(args, {"verdict": "passed", "trials": {}}, f"{len(trials)} trials read")
        return DONE
    verdicts = [check_trial(trial) for trial in trials]
    shared = ImportVerdict("all trials", check_trials(trials))
    if plant:
        values = {name: parameter.value for name, parameter in plant.parameters.items()}
        shared.findings += judge_payload_unit(trials, values)
    if args.out:
        for verdict in verdicts:
            write_verdict(verdict, args.out)
    words = {verdict.word for verdict in (*verdicts, shared)}
    word = next(word for word in ("refused", "warned", "passed") if word in words)
    result = {
        "verdict": word,
        "findings": shared.as_json()["findings"],
        "trials": {v.name: v.as_json() for v in verdicts},
    }
    lines = []
    for verdict in verdicts:
        lines.append(f"{verdict.name}: {verdict.word}")
        lines += [f"  {f.level}: {f.text}; {f.remedy}" for f in verdict.findings]
    lines += [f"{shared.name}: {f.level}: {f.text}; {f.remedy}" for f in shared.findings]
    emit(args, result, "\n".join([*lines, f"{len(verdicts)} trials {word}"]))
    return NEGATIVE if word == "refused" else DONE
