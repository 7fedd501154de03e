"""Description of a link of your own, `link.toml`, asked for or from options.

What is not given is asked for where a terminal is there, else the study's value is taken. The file
holds every key with its meaning: the sizes, the places of the markers, the mounting, and the
servo's numbers with their source. 'simulate --rig', 'identify --plant', a map's 'link', 'hil sil
--rig' and robot.toml take it.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import msgspec

from firmware_py.bus.servo_models import model_named
from firmware_py.console import DONE, emit
from firmware_py.errors import InputError
from firmware_py.link.link_description import (
    DIRECTIONS,
    STUDY_LINK,
    LinkDescription,
    LinkGravity,
    LinkServo,
    check_link,
)
from firmware_py.link.link_file import link_toml
from firmware_py.link.marker_layout import MarkerLayout, square_corners_m
from firmware_py.link.servo_presets import PRESETS
from models.shared.link_scale import LinkScale

EXAMPLE = (
    "python -m models new link.toml --length 0.6 --width 0.1 --rows 3 --servo XM430-W350 "
    "--mounting hanging --payload 0.1"
)

RECOMMENDED_TORQUE: Final = 0.2
"""Part of the torque at the current limit that a steady load should not exceed: the e-Manual's note
on stall torque, a fifth."""
PAYLOAD_STEP_KG: Final = 0.05

_QUESTIONS: Final[dict[str, tuple[str, Callable[[str], Any]]]] = {
    "length": ("length from the base plate to the last marker row, m", float),
    "width": ("side of the section, m", float),
    "base_offset": ("base plate above the joint axes, m", float),
    "joints": ("driven joints, 1 or 2", int),
    "rows": ("rows of markers", int),
    "corners": ("markers in a row", int),
    "mounting": (f"mounting: {', '.join(DIRECTIONS)}", str),
    "servo": (f"servo: {', '.join(PRESETS)}", str),
    "payload": ("largest payload, kg (empty: what the servo carries)", float),
}
"""What is asked for where a terminal is there."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add("link", type=Path, metavar="LINK.toml", help="file to write")
    add("--length", type=float, metavar="M", help="base plate to last marker row (0.95)")
    add("--width", type=float, metavar="M", help="side or diameter of the section (0.15)")
    add("--section", choices=("square", "round"), default="square", help="its shape (square)")
    add("--base-offset", type=float, metavar="M", help="base plate above the joint axes (0.06)")
    add("--joints", type=int, choices=(1, 2), help="driven joints (2)")
    add("--rows", type=int, metavar="N", help="rows of markers at equal distances (4)")
    add("--corners", type=int, metavar="N", help="markers in a row (4)")
    add("--mounting", choices=tuple(DIRECTIONS), help="how it stands at zero angle (upright)")
    add(
        "--effective-weight", type=float, default=1.0, metavar="PART",
        help="part of the weight that is left with a balloon (1)",
    )  # fmt: skip
    add("--servo", choices=tuple(PRESETS), help="model of the servos (H54-200-S500-R)")
    add("--payload", type=float, metavar="KG", help="largest payload (what the servo carries)")
    add("--mass", type=float, metavar="KG", help="of the link, weighed (estimated)")
    add("--tip-mass", type=float, metavar="KG", help="of the hardware at its tip (estimated)")
    add("--pressure-pa", type=float, default=STUDY_LINK.pressure_pa, help="inflation (41300)")
    add("--name", default="link", help="for people")
    add("--force", action="store_true", help="write over a file that exists")


def run(args: argparse.Namespace) -> int:
    """Ask, check, write, and say what follows from it.

    Raises
    ------
    InputError
        If the file exists, or a value cannot be.
    """
    if args.link.exists() and not args.force:
        raise InputError(args.link, "exists", "name another file, or add --force")
    if sys.stdin.isatty() and not args.json:
        _ask(args)
    link = _described(args)
    check_link(link, args.link)
    scale = LinkScale(link)
    args.link.parent.mkdir(parents=True, exist_ok=True)
    args.link.write_text(link_toml(link, scale.mass_kg, scale.tip_mass_kg), encoding="utf-8")
    used = scale.holding_nm / link.preset.torque_limit_nm
    facts = {
        "link": str(args.link), "markers": link.layout.count, "mass_kg": scale.mass_kg,
        "payload_kg": link.payload_kg, "first_mode_hz": scale.first_mode_rad_s / (2 * math.pi),
        "holding_torque_nm": scale.holding_nm, "holding_torque_of_limit": used,
    }  # fmt: skip
    text = (
        f"{args.link}: {link.length_m:g} m × {link.width_m:g} m, {link.layout.count} markers, "
        f"{link.gravity.mounting}, {link.servo.model}; about {scale.mass_kg:.2f} kg, first mode "
        f"{facts['first_mode_hz']:.1f} Hz, payload up to {link.payload_kg:g} kg"
    )
    if used > RECOMMENDED_TORQUE:
        text += (
            f"\nwarning: held at 30° it needs {scale.holding_nm:.2f} N·m, {used:.0%} of what the "
            f"servo has; a fifth is recommended"
        )
    emit(args, facts, text)
    return DONE


def _ask(args: argparse.Namespace) -> None:
    """Ask for what was not given; an empty answer takes the study's value."""
    for key, (question, kind) in _QUESTIONS.items():
        while getattr(args, key) is None:
            answer = input(f"{question}: ").strip()
            if not answer:
                break
            try:
                setattr(args, key, kind(answer))
            except ValueError:
                print(f"{answer!r} is no number", file=sys.stderr)


def _described(args: argparse.Namespace) -> LinkDescription:
    given = {
        "length_m": args.length, "width_m": args.width, "base_offset_m": args.base_offset,
        "joints": args.joints, "mass_kg": args.mass, "tip_mass_kg": args.tip_mass,
        "payload_kg": args.payload,
    }  # fmt: skip
    servo = args.servo or STUDY_LINK.servo.model
    model_named(servo)
    link = LinkDescription(
        name=args.name, section=args.section, pressure_pa=args.pressure_pa,
        servo=LinkServo(model=servo),
        gravity=LinkGravity(
            mounting=args.mounting or "upright", effective_weight=args.effective_weight
        ),
        **{key: value for key, value in given.items() if value is not None},
    )  # fmt: skip
    rows, corners = args.rows or 4, args.corners or 4
    if not (1 <= rows <= 99 and 1 <= corners <= 99):
        raise InputError("--rows, --corners", f"are {rows} and {corners}", "give 1 to 99")
    heights = tuple(round(link.length_m * k / rows, 6) for k in range(1, rows + 1))
    places = _corners_m(corners, link.marker_width_m)
    link = msgspec.structs.replace(link, markers=MarkerLayout(heights, places))
    if args.payload is None:
        link = msgspec.structs.replace(link, payload_kg=_payload_kg(link))
    return link


def _corners_m(count: int, width_m: float) -> tuple[tuple[float, float], ...]:
    """Places of the markers of a row: the corners, or two of them opposite, or a ring."""
    square = square_corners_m(width_m)
    if count == 4:
        return square
    if count == 1:
        return ((0.0, 0.0),)
    if count == 2:
        return (square[0], square[3])
    ring = [2 * math.pi * k / count for k in range(count)]
    half = width_m / 2
    return tuple((round(half * math.cos(a), 6), round(half * math.sin(a), 6)) for a in ring)


def _payload_kg(link: LinkDescription) -> float:
    """Largest payload with which the servo holds the link at 30° by a fifth of its torque."""
    empty = msgspec.structs.replace(link, payload_kg=0.0)
    one_kg = msgspec.structs.replace(link, payload_kg=1.0)
    own_nm = LinkScale(empty).holding_nm
    per_kg_nm = LinkScale(one_kg).holding_nm - own_nm
    spare_nm = RECOMMENDED_TORQUE * link.preset.torque_limit_nm - own_nm
    if per_kg_nm <= 0:
        return STUDY_LINK.payload_kg
    return max(PAYLOAD_STEP_KG * int(spare_nm / per_kg_nm / PAYLOAD_STEP_KG + 1e-9), 0.0)
