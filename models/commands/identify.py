"""Identification of a plant from trials, with standard errors and held-out errors.

The trials with the lowest number at the largest amplitude of each motion are fitted; the others are
held out. A figure that compares the plant with the measurement is written beside OUT.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Final

import msgspec

from firmware_py.bus.servo_models import GAINS, ServoGains
from firmware_py.config import read_config
from firmware_py.core.console import DONE, Progress, emit
from firmware_py.core.errors import InputError
from firmware_py.log.recording import read_recording
from models.plant.identification.identify import identify
from models.plant.parameter import bound_reached, is_weakly_determined
from models.plant.plant import read_plant
from models.shared.output_paths import check_output_file
from models.trials.files import conditions_beside, read_trial_directories

EXAMPLE = (
    "dropstitch identify build/trials --plant models/plant/nominal.toml --out build/plant.json"
)

USUAL_STEPS: Final = 130
"""Usual number of runs of all trials in an identification, for progress [measured: 50 to 160]."""


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("trials", type=Path, metavar="DIR", help="directory of trials")
    parser.add_argument(
        "--plant", type=Path, required=True, metavar="PLANT", help="plant to start from"
    )
    parser.add_argument("--out", type=Path, required=True, help="plant to write (JSON or TOML)")
    parser.add_argument(
        "--gains", type=Path, metavar="LOG.mcap|ROBOT.toml",
        help="log of a run, or configuration, with the gains that the servos had in the trials; a "
        "bundle of this plant then runs with these gains only",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    _check_out(args)
    gains = read_servo_gains(args.gains) if args.gains is not None else ()
    plant = read_plant(args.plant)
    trials = read_trial_directories([args.trials], plant.signals)
    check_output_file(args.out, [conditions_beside(t.path) for t in trials])
    progress = Progress("identify", USUAL_STEPS, is_estimate=True)

    def report(text: str) -> None:
        progress.step(text, further=max(progress.total - progress.done - 1, 10))

    result = identify(plant, trials, report, servo_gains=gains)
    progress.total = progress.done + 1
    progress.step("done")
    result.plant.write(args.out)
    picture = args.out.with_suffix(".svg")
    from models.shared.drawing import save_svg  # loads matplotlib

    save_svg(result.plot(), picture)
    warnings = result.warnings()
    data = {
        "plant": str(args.out),
        "picture": str(picture),
        "parameters": {
            q.name: {
                "value": q.value,
                "error": q.error,
                "unit": q.unit,
                "bound": bound_reached(q),
                "weakly_determined": is_weakly_determined(q),
            }
            for q in result.fitted
        },
        "held_out": msgspec.to_builtins(result.held_out),
        "warnings": warnings,
    }
    emit(args, data, f"{result.summary()}\n\n{args.out}; look at {picture}")
    for warning in warnings:
        print(f"warning: {warning}", file=sys.stderr)
    return DONE


def _check_out(args: argparse.Namespace) -> None:
    """Refuse a name that a plant cannot have, and one that would replace an input.

    The plant itself may be replaced: the fit starts from it.
    """
    if args.out.suffix.lower() not in (".json", ".toml"):
        raise InputError(
            f"--out {args.out}", "is no JSON or TOML file", "let its name end with .json or .toml"
        )
    gains = [args.gains] if args.gains is not None else []
    check_output_file(args.out, gains)
    check_output_file(args.out.with_suffix(".svg"), [args.plant, *gains])


def read_servo_gains(path: Path) -> tuple[ServoGains, ...]:
    """Read the gains of each servo, in joint order.

    `path` is robot.toml or a log of `dropstitch run`, which records the gains read from the servos.
    """
    if path.suffix == ".mcap":
        text = read_recording(path).metadata.get("servo_settings", "[]")
        try:
            servos = msgspec.json.decode(text, type=list[dict[str, int]])
        except (ValueError, RecursionError) as error:
            raise InputError(
                path, f"holds damaged settings ({error})", "name another log"
            ) from None
        gains = tuple(
            ServoGains(**{name: servo.get(register.value) for name, register in GAINS.items()})
            for servo in servos
        )
    else:
        gains = tuple(servo.gains or ServoGains() for servo in read_config(path).servos)
    if not gains or not all(one.registers() for one in gains):
        raise InputError(
            path, "does not give the gains of every servo",
            "name a log of this release, or add gains to each [[servos]]",
        )  # fmt: skip
    return gains
