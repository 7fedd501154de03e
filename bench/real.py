"""Benchmark on measured data of other machines, through the commands of this project.

Import, identify, gap, identify. Each system is described by a plant file and a map
(models/plant/examples): the XL330 pendulum, a DYNAMIXEL that swings a weight (Rhoban/bam), and the
EMPS, a car on a ball screw (Janot et al.), and a flexible link, with its joint as measured and
driven by a measured current (Quanser). The gap workflow names what the plant lacks, until it
finds nothing more. The named effects are then refitted with each gain and each motion of the
pendulum and each record of the flexible link left out in turn, and judged on those, beside simpler
fits treated alike.

Writes OUT/real.json, OUT/real.html and the plants OUT/SYSTEM/plant.json; exit 1 if a limit is
missed. Steps that the same code did are not repeated.

    python -m bench.real DATA --out build/bench_real
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from bench.measured_systems import (
    BASELINE,
    BLOCK,
    FOUND,
    GAIN,
    MOTION,
    PLAIN,
    PUBLISHED,
    RECORD,
    SYSTEMS,
    MeasuredSystem,
)
from bench.real_page import write_real_page
from firmware_py.console import DONE, NEGATIVE, Progress
from firmware_py.errors import InputError
from hil.campaign.code_version import code_version
from models.__main__ import main as models
from models.gap.report.gap_json import read_gap_document
from models.gap.residuals.time_blocks import in_time_blocks
from models.plant.identification.evaluation import compare_with_trials
from models.plant.identification.identification import identify
from models.plant.plant import Plant, read_plant
from models.trials.trial import TrialSet
from models.trials.trial_files import read_trials

EXAMPLES: Final = Path(__file__).parents[1] / "models/plant/examples"

DIFFERS_BY_DIRECTION: Final = frozenset({"directional_friction", "load_offset"})
"""Effects of which one must be named on the EMPS; on all speeds but one they differ."""

ROOMS: Final = ("firmware_py", "models")
"""Rooms whose code computes the steps."""

ROUNDS: Final = 4
"""Most times that the gap is looked for and the plant identified again."""


def import_recordings(system: MeasuredSystem, data: Path, out: Path) -> TrialSet:
    nominal = read_plant(EXAMPLES / f"{system.name}.toml")
    for file in sorted((data / system.folder).glob(system.pattern)):
        if not (out / f"{file.stem}.toml").exists():
            command = ["import", str(file), "--as", "table", "--out", str(out)]
            _command([*command, "--map", str(EXAMPLES / f"{system.name}.map.toml")])
    return read_trials(out, nominal.signals)


def name_and_identify(
    system: MeasuredSystem, trials: Path, out: Path
) -> tuple[Path, list[list[str]]]:
    """Plant with all that the program names, and what it named in each round."""
    plant, rounds = EXAMPLES / f"{system.name}.toml", []
    if system.identified_first:
        plant = out / "identified_0.json"
        _identify(trials, EXAMPLES / f"{system.name}.toml", plant)
    for k in range(1, ROUNDS + 1):
        gap = out / f"gap_{k}"
        if not (gap / "report.html").exists():
            command = ["gap", str(trials), "--plant", str(plant), "--out", str(gap)]
            _command(command, negative=True)
        named = read_gap_document(gap / "gap.json").named
        rounds.append([e for row in named if row.kept for e in row.effect.split(" + ")])
        if not rounds[-1]:
            break
        better = out / f"identified_{k}.json"
        _identify(trials, gap / "plant.json", better)
        plant = better
    return plant, rounds


def _identify(trials: Path, plant: Path, out: Path) -> None:
    if not out.exists():
        _command(["identify", str(trials), "--plant", str(plant), "--out", str(out)])


def _command(arguments: list[str], negative: bool = False) -> None:
    print("$ python -m models", " ".join(arguments), file=sys.stderr)
    code = models([*arguments, "--json"])
    if code != DONE and not (negative and code == NEGATIVE):
        raise SystemExit(code)


def identified_plant(
    plant: Plant, trials: TrialSet, path: Path, step: Callable[[str], None]
) -> Plant:
    """Plant identified on trials; read where it was before."""
    if not path.exists():
        identify(plant, trials).plant.write(path)
    step(path.stem)
    return read_plant(path)


def errors_by_trial(plant: Plant, trials: TrialSet, signal: str) -> dict[str, dict[str, float]]:
    """Mean absolute and root mean square error of a signal, by trial."""
    result = {}
    for c in compare_with_trials(plant, trials):
        error = c.error(signal)
        result[c.trial.name] = {
            "mae": float(np.mean(np.abs(error))), "rms": float(np.sqrt(np.mean(error**2)))
        }  # fmt: skip
    return result


def judge_fit(
    system: MeasuredSystem, plant: Plant, trials: TrialSet, out: Path, step: Callable[[str], None]
) -> dict[str, Any]:
    """Errors of one structure: of a fit to all trials, and with each condition left out."""
    full = identified_plant(plant, trials, out / "all.json", step)
    row: dict[str, Any] = {"effects": list(full.effects)}
    row["all"] = _mean(errors_by_trial(full, trials, system.signal), system.measure)
    trials = in_time_blocks(plant, trials)
    for what, value_of in system.leave_out.items():
        left: dict[str, dict[str, float]] = {}
        for value in sorted({value_of(t) for t in trials}, key=str):
            rest = trials.where(lambda t, of=value_of, v=value: of(t) != v)
            own = trials.where(lambda t, of=value_of, v=value: of(t) == v)
            name = value if isinstance(value, str) else f"{value:.3g}"
            fit = identified_plant(plant, rest, out / f"without_{name}.json", step)
            left |= errors_by_trial(fit, own, system.signal)
        row.setdefault("left_out_by", {})[what] = _mean(left, system.measure)
        row.setdefault("left_out", row["left_out_by"][what])
        by_trial = row.setdefault("left_out_by_trial", {})
        by_trial[what] = {name: e[system.measure] for name, e in left.items()}
    return row


def _mean(by_trial: dict[str, dict[str, float]], measure: str) -> float:
    return float(np.mean([e[measure] for e in by_trial.values()]))


def run_system(
    system: MeasuredSystem, data: Path, out: Path, step: Callable[[str], None]
) -> dict[str, Any]:
    """Everything about one system."""
    trials = import_recordings(system, data, out / "trials")
    found, rounds = name_and_identify(system, out / "trials", out)
    step("named")
    shutil.copyfile(found, out / "plant.json")
    nominal, plant = read_plant(EXAMPLES / f"{system.name}.toml"), read_plant(found)
    fits = {
        label: judge_fit(system, nominal.with_effects(*effects), trials, out / label, step)
        for label, effects in system.ladder.items()
    }
    held = [e for e in plant.effects if e not in nominal.effects]
    fits[FOUND] = judge_fit(system, nominal.with_effects(*held), trials, out / FOUND, step)
    fits[FOUND]["all"] = _mean(errors_by_trial(plant, trials, system.signal), system.measure)
    return {
        "rounds": rounds,
        "plant": str(out / "plant.json"),
        "unit": system.unit,
        "measure": system.measure,
        "fits": fits,
        "parameters": {
            q.name: {"value": q.value, "error": q.error, "unit": q.unit}
            for q in plant.parameters.values() if q.error is not None
        },
    }  # fmt: skip


def real_data_verdicts(result: dict[str, Any]) -> list[dict[str, Any]]:
    """The figures that have limits, of the systems that were run."""
    rows: list[tuple[str, float, float]] = []
    if "xl330_pendulum" in result:
        for what, most in ((GAIN, 0.75), (MOTION, 0.70)):
            ratio = _ratio(result["xl330_pendulum"], BASELINE, what)
            rows.append(
                (f"XL330, {what}s left out: error over that of viscous + Coulomb", ratio, most)
            )
    if "emps" in result:
        car = result["emps"]
        named = {e for round_ in car["rounds"] for e in round_}
        lacking = ("coulomb_friction" not in named) + (not named & DIFFERS_BY_DIRECTION)
        rows.append(("EMPS: root mean square error, mm", 1e3 * car["fits"][FOUND]["all"], 3.0))
        rows.append(("EMPS: of Coulomb and directional friction not named", lacking, 0.0))
        ratio = _ratio(car, PUBLISHED, BLOCK)
        rows.append(("EMPS, blocks left out: error over that of the published terms", ratio, 1.0))
    if "flexible_link" in result:
        ratio = _ratio(result["flexible_link"], PLAIN, RECORD)
        rows.append(
            ("flexible link, records left out: error over that without effects", ratio, 0.30)
        )
    return [
        {"limit": what, "value": float(value), "at_most": most, "met": bool(value <= most)}
        for what, value, most in rows
    ]


def _ratio(system: dict[str, Any], reference: str, what: str) -> float:
    fits = system["fits"]
    return float(fits[FOUND]["left_out_by"][what] / fits[reference]["left_out_by"][what])


def keep_steps_of_this_code(directory: Path, version: str) -> None:
    """Delete what other code left in the directory of a system: it is computed anew."""
    file = directory / "code.txt"
    if directory.exists():
        if not file.exists():
            raise InputError(directory, "holds files of unknown code", "delete it or change --out")
        if file.read_text(encoding="utf-8") != version:
            shutil.rmtree(directory)
    directory.mkdir(parents=True, exist_ok=True)
    file.write_text(version, encoding="utf-8")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the systems, judge, write."""
    parser = argparse.ArgumentParser(prog="python -m bench.real", description=__doc__)
    parser.add_argument("data", type=Path, metavar="DATA", help="folder of the recordings")
    parser.add_argument("--out", type=Path, default=Path("build/bench_real"))
    known = [s.name for s in SYSTEMS]
    parser.add_argument("--only", nargs="*", default=known, choices=known, help="systems to run")
    args = parser.parse_args(argv)
    chosen = [system for system in SYSTEMS if system.name in args.only]
    for system in chosen:
        if not any((args.data / system.folder).glob(system.pattern)):
            parser.error(f"{args.data / system.folder} holds no {system.pattern}")
        try:
            keep_steps_of_this_code(args.out / system.name, code_version(ROOMS))
        except InputError as error:
            parser.error(str(error))
    progress, result = Progress("real", 0), {}
    for left, system in zip(reversed(range(len(chosen))), chosen, strict=True):
        step = partial(progress.step, further=left + 1)
        result[system.name] = run_system(system, args.data, args.out / system.name, step)
    progress.step("judged", 0)
    data = {"systems": result, "verdicts": real_data_verdicts(result)}
    (args.out / "real.json").write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
    page = write_real_page(data, args.out)
    for v in data["verdicts"]:
        print(f"{'met   ' if v['met'] else 'MISSED'} {v['limit']}: {v['value']:.3g} "
              f"(at most {v['at_most']:g})")  # fmt: skip
    print(page)
    return DONE if all(v["met"] for v in data["verdicts"]) else NEGATIVE


if __name__ == "__main__":
    sys.exit(main())
