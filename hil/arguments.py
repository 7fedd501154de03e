"""Arguments common to several commands: servos, line, and payload at the tip."""

from __future__ import annotations

import argparse

from firmware_py.bus.servo_models import MODELS
from hil.emulator.line_faults import FAULT_KINDS


def add_line_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of an `EmulatorSpecification`."""
    models = ", ".join(model.name for model in MODELS.values())
    parser.add_argument(
        "--model", default="H54-200-S500-R", help=f"servo (default: %(default)s): {models}"
    )
    parser.add_argument(
        "--baud", type=int, default=1_000_000, help="bits per second (default: %(default)s)"
    )
    parser.add_argument(
        "--latency-ms", type=float, default=1.0,
        help="latency timer of the USB adapter (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--payload-kg", type=float, default=1.0, help="at the tip (default: %(default)s)"
    )
    parser.add_argument(
        "--faults", nargs="+", default=[], metavar="KIND=RATE",
        help="fractions of the status packets that are " + ", ".join(FAULT_KINDS),
    )  # fmt: skip
    parser.add_argument("--seed", type=int, default=0, help="of everything random")
