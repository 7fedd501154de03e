"""Arguments that several commands share: servos, line, and payload at the tip."""

from __future__ import annotations

import argparse
from pathlib import Path

from firmware_py.bus.servo_models import MODELS
from firmware_py.link.link_description import STUDY_LINK, LinkDescription
from hil.emulator.line_faults import LINE_FAULTS
from models.plant.document import link_of_plant


def add_line_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of an `EmulatorSpecification`."""
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


def complete_from_link(args: argparse.Namespace, plant: Path | None) -> LinkDescription:
    """Return the link, and fill in the servo and payload that the user did not set from it.

    `plant` is a plant document or the file of a link; without one the study's link is used.
    """
    link = link_of_plant(plant) if plant is not None and plant.is_file() else STUDY_LINK
    if args.model is None:
        args.model = link.servo.model
    if args.payload_kg is None:
        args.payload_kg = link.payload_kg / 2
    return link
