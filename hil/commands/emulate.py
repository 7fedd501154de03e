"""Emulate servos for any Dynamixel program until Ctrl-C; print the name of the port to open.

The servos share one bus and move a simulated plant: goals that your program writes move the plant,
and the measurements that it reads come from the plant. If the kernel permits it, the emulator runs
at the real-time priority that a robot's loop has by default.
"""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory, gettempdir
from typing import Final

from firmware_py.bus.servo_models import MODELS, model_named
from firmware_py.core.console import DONE, Progress, Terminated, emit, terminations_raised
from firmware_py.core.errors import InputError
from firmware_py.link.link_description import STUDY_LINK
from firmware_py.system.clock import RealTimeOptions, real_time
from hil.emulator.emulator import EmulatorSpecification, serve_forever
from hil.emulator.line_faults import LINE_FAULTS, parse_rates
from hil.emulator.physics import build_twin
from models.plant.document import link_of_plant

SCHEDULING: Final = RealTimeOptions(lock_memory=False, freeze_gc=False)
"""Scheduling of a robot's loop by default, which suffices: a loop that waits for a reply sleeps.
Garbage is collected, because the servos run for days."""
NOT_REAL_TIME: Final = (
    "dropstitch emulate: warning: the kernel refuses real-time priority, so on a busy machine "
    "the servos answer late and the ticks of a loop may be out of range; run it as root or grant "
    "CAP_SYS_NICE"
)
EXAMPLE = "dropstitch emulate --model PH54-200-S500-R --line pty --plant build/plant.json"


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--line", choices=("pty", "socket"), default="pty")
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--plant", type=Path, metavar="PLANT", help="plant file behind the servos")
    source.add_argument("--fmu", type=Path, help="or a twin that was built from one")
    parser.add_argument(
        "--ids", type=int, nargs="+", default=[1], help="one per joint, 1 or 2 (default: 1)"
    )
    parser.add_argument(
        "--path", type=Path, default=Path(gettempdir()) / f"dropstitch-{os.getpid()}",
        help="of the socket",
    )  # fmt: skip
    add_line_arguments(parser)


def add_line_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of servos and line, which `dropstitch sil` has as well."""
    models = ", ".join(model.name for model in MODELS.values())
    parser.add_argument(
        "--model", help=f"servo (default: that of the link, or {STUDY_LINK.servo.model}): {models}"
    )
    parser.add_argument(
        "--baud", type=int, default=1_000_000, help="bits per second (default: %(default)s)"
    )
    parser.add_argument(
        "--latency-ms", type=float, default=1.0,
        help="latency timer of the USB adapter (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--payload-kg", type=float, help="at the tip (default: half of the link's largest, or 1.0)"
    )
    parser.add_argument(
        "--faults", nargs="+", default=[], metavar="KIND=RATE",
        help="fractions of the packets that are " + ", ".join(LINE_FAULTS),
    )  # fmt: skip
    parser.add_argument("--seed", type=int, default=0, help="of everything random")


def run(args: argparse.Namespace) -> int:
    link = link_of_plant(args.plant) if args.plant else STUDY_LINK
    model = model_named(args.model or link.servo.model)
    payload_kg = link.payload_kg / 2 if args.payload_kg is None else args.payload_kg
    if args.line == "socket" and args.path.exists():
        raise InputError(args.path, "exists already", "name another --path, or remove it")
    with TemporaryDirectory(prefix="dropstitch-emulate-") as scratch:
        specification = EmulatorSpecification(
            args.fmu or args.plant, model.number, tuple(args.ids), args.baud,
            latency_s=args.latency_ms * 1e-3, payload_kg=payload_kg,
            faults=parse_rates(args.faults), seed=args.seed,
        )  # fmt: skip
        if args.plant:  # last: it takes seconds
            Progress("emulate", 1).begin("building the twin")
            twin = build_twin(args.plant, len(args.ids), Path(scratch))
            specification = replace(specification, source=twin)

        def announce(name: str) -> None:
            announced = {"port": name, "model": model.name, "ids": args.ids, "baud": args.baud}
            ids = " and ".join(map(str, args.ids))
            text = f"{name}\n{model.name}, id {ids}, {args.baud} baud; Ctrl-C ends it"
            emit(args, announced, text)
            sys.stdout.flush()
            if refused:
                print(NOT_REAL_TIME, file=sys.stderr, flush=True)

        try:
            with terminations_raised(), real_time(SCHEDULING) as refused:
                serve_forever(specification, args.line, args.path, announce)
        except Terminated:
            raise
        except KeyboardInterrupt:
            print(file=sys.stderr)
    return DONE
