"""Recordings of other machines: what the gap workflow names, and how much better the plant is then.

Each system is described by a plant file and a map (models/plant/examples): the XL330 pendulum, a
DYNAMIXEL that swings a weight (Rhoban/bam); the EMPS, a car on a ball screw (Janot et al.); and a
flexible link, with its joint as measured and driven by a measured current (Quanser). The gap
workflow names what the plant lacks until it finds nothing more. Then every gain (block of time,
record) is left out in turn: the plant is identified on the rest and judged on it, beside a plant
with the reference's effects.

Writes OUT/real.json; a step whose files are there is not repeated.

    python -m bench.real DATA --out build/real
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from dropstitch.__main__ import main as dropstitch
from firmware_py.core.console import DONE, NEGATIVE, Progress
from models.gap.report.gap_json import read_gap_document
from models.gap.residuals.time_blocks import in_time_blocks
from models.plant.identification.evaluation import compare_with_trials
from models.plant.identification.identify import identify
from models.plant.plant import Plant, read_plant
from models.shared.worker_pool import worker_pool
from models.trials.files import read_trials
from models.trials.trial import Trial, TrialSet

EXAMPLES: Final = Path(__file__).parents[1] / "models/plant/examples"

ROUNDS: Final = 4
"""Most times that the gap is looked for and the plant identified again."""


def gain_of(trial: Trial) -> float:
    """Declared position gain, 1/rad."""
    return trial.meta.conditions["duty_gain_1"]


def block_of(trial: Trial) -> str:
    """Block of time of a part of one recording."""
    return trial.meta.motion


@dataclass(frozen=True)
class MeasuredSystem:
    """Recordings of one machine."""

    name: str  # Of its plant and map in models/plant/examples
    folder: str
    pattern: str
    signal: str  # Signal that is compared, and its error: "mae" or "rms"
    measure: str
    # Effects beside viscous friction of the plant that the found one is compared with
    reference: tuple[str, ...]
    left_out: str  # What is left out in turn, and its value in a trial
    value_of: Callable[[Trial], float | str]
    # Whether the plant is identified before the gap is looked for. A joint that nothing holds and
    # whose friction is missing is not: the fit makes up for it by values at their bounds.
    identified_first: bool = True


SYSTEMS: Final = {
    system.name: system
    for system in (
        MeasuredSystem("xl330_pendulum", "bam_xl330", "*.json", "angle_1_rad", "mae",
                       ("coulomb_friction",), "gain", gain_of),
        MeasuredSystem("emps", "emps", "*.mat", "position_1_m", "rms",
                       ("coulomb_friction", "load_offset"), "block of time", block_of),
        MeasuredSystem("flexible_link", "quanser", "lqg_step_*.mat", "deflection_1_rad", "rms",
                       (), "record", lambda t: t.name),
        MeasuredSystem("driven_flexible_link", "quanser", "lqr_full_*.mat", "angle_1_rad", "rms",
                       ("coulomb_friction",), "block of time", block_of, identified_first=False),
    )
}  # fmt: skip


def import_recordings(system: MeasuredSystem, data: Path, out: Path) -> TrialSet:
    """Trials of every recording of a system, written to OUT."""
    nominal = read_plant(EXAMPLES / f"{system.name}.toml")
    for file in sorted((data / system.folder).glob(system.pattern)):
        if not (out / f"{file.stem}.toml").exists():
            _models("import", str(file), "--as", "table", "--out", str(out),
                    "--map", str(EXAMPLES / f"{system.name}.map.toml"))  # fmt: skip
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
            _models("gap", str(trials), "--plant", str(plant), "--out", str(gap), negative=True)
        named = read_gap_document(gap / "gap.json").named
        rounds.append([row.effect for row in named])
        if not rounds[-1]:
            break
        better = out / f"identified_{k}.json"
        _identify(trials, gap / "plant.json", better)
        plant = better
    return plant, rounds


def mean_error(plant: Plant, trials: TrialSet, system: MeasuredSystem) -> float:
    """Mean over the trials of the error of the compared signal, in SI."""
    errors = [c.error(system.signal) for c in compare_with_trials(plant, trials)]
    if system.measure == "mae":
        return float(np.mean([np.mean(np.abs(e)) for e in errors]))
    return float(np.mean([np.sqrt(np.mean(e**2)) for e in errors]))


def error_left_out(
    system: MeasuredSystem, plant: Plant, trials: TrialSet, step: Callable[[str], None]
) -> float:
    """Mean error of an effect structure on what is left out in turn, in SI."""
    trials = in_time_blocks(plant, trials)
    values = sorted({system.value_of(t) for t in trials}, key=str)
    errors, counts = [], []
    for value in values:
        rest = TrialSet(tuple(t for t in trials if system.value_of(t) != value))
        left_out = TrialSet(tuple(t for t in trials if system.value_of(t) == value))
        errors.append(mean_error(identify(plant, rest, noise_floor=False).plant, left_out, system))
        counts.append(len(left_out))
        step(f"{system.name}, {system.left_out} {value}")
    return float(np.average(errors, weights=counts))


def run_system(name: str, data: Path, out: Path) -> dict[str, Any]:
    """Import, name, identify, and compare with the reference on what is left out."""
    system, work = SYSTEMS[name], out / name
    work.mkdir(parents=True, exist_ok=True)
    trials = import_recordings(system, data, work / "trials")
    identified, rounds = name_and_identify(system, work / "trials", work)
    nominal, plant = read_plant(EXAMPLES / f"{name}.toml"), read_plant(identified)
    progress = Progress(name, 0)
    step = lambda text: progress.step(text, further=1)  # noqa: E731
    named = nominal.with_effects(*(e for e in plant.effects if e not in nominal.effects))
    reference = nominal.with_effects(*system.reference)
    error = error_left_out(system, named, trials, step)
    error_reference = error_left_out(system, reference, trials, step)
    return {
        "rounds": rounds,
        "recordings": len(trials),
        "error": mean_error(plant, trials, system),
        "error_left_out": error,
        "reference": list(system.reference),
        "reference_error_left_out": error_reference,
        "ratio": error / error_reference,
    }


def run_systems(names: Sequence[str], data: Path, out: Path) -> dict[str, dict[str, Any]]:
    """The systems, two at a time."""
    with worker_pool(2) as pool:
        begun = {pool.submit(run_system, name, data, out): name for name in names}
        results = {begun[done]: done.result() for done in as_completed(begun)}
    return {name: results[name] for name in names}


def _identify(trials: Path, plant: Path, out: Path) -> None:
    if not out.exists():
        _models("identify", str(trials), "--plant", str(plant), "--out", str(out))


def _models(*arguments: str, negative: bool = False) -> None:
    """One of the commands of this project; its table goes to standard error."""
    print("$ dropstitch", *arguments, file=sys.stderr)
    with redirect_stdout(sys.stderr):
        code = dropstitch(list(arguments))
    if code != DONE and not (negative and code == NEGATIVE):
        raise RuntimeError(f"{arguments[0]} ended with exit code {code}")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the systems and print the figures as JSON."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.real", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("data", type=Path, metavar="DATA", help="folder of the recordings")
    parser.add_argument("--out", type=Path, default=Path("build/real"))
    parser.add_argument("--only", nargs="*", default=list(SYSTEMS), choices=SYSTEMS)
    args = parser.parse_args(argv)
    for name in args.only:
        folder, pattern = args.data / SYSTEMS[name].folder, SYSTEMS[name].pattern
        if not any(folder.glob(pattern)):
            parser.error(f"{folder} holds no {pattern}")
    text = json.dumps(run_systems(args.only, args.data, args.out), indent=1) + "\n"
    (args.out / "real.json").write_text(text, encoding="utf-8")
    print(text, end="")
    return DONE


if __name__ == "__main__":
    sys.exit(main())
