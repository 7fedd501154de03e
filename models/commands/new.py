"""Description of your link, `link.toml`, asked for or from options.

Without options it asks for every value in a terminal; an empty answer takes the value in brackets.
With options, or without a terminal, values that you omit are the study's. The file has every key
with its meaning: the sizes, the places of the markers, the mounting, and the servo's numbers with
their source. 'simulate --rig', 'identify --plant', 'sil --rig', a map's 'link' and robot.toml take
it.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec

from firmware_py.bus.servo_models import PRESETS
from firmware_py.core.console import DONE, emit
from firmware_py.core.errors import InputError
from firmware_py.link.link_description import (
    DIRECTIONS,
    STUDY_LINK,
    LinkDescription,
    LinkGravity,
    LinkServo,
    check_link,
)
from firmware_py.link.marker_layout import MarkerLayout, square_corners_m
from models.shared.link_scale import LinkScale

EXAMPLE = (
    "dropstitch new link.toml --length 0.6 --width 0.1 --rows 3 --servo XM430-W350 "
    "--mounting hanging --largest-payload-kg 0.1"
)

RECOMMENDED_TORQUE: Final = 0.2
"""Part of the torque at the current limit that a steady load should not exceed: the e-Manual's note
on stall torque, a fifth."""


class _Option(NamedTuple):
    """Option, which is a question in the terminal too."""

    words: str
    default: Any  # Value of an omitted option, and for an empty answer
    metavar: str | None = None
    kind: Callable[[str], Any] = float  # Converts an answer; raises ValueError
    choices: tuple[Any, ...] = ()  # Allowed values; empty for any


_ASKED: Final = {
    "length": _Option(
        "length from the base plate to the last marker row, m", STUDY_LINK.length_m, "M"
    ),
    "section": _Option("section", STUDY_LINK.section, None, str, ("square", "round")),
    "width": _Option("side or diameter of the section, m", STUDY_LINK.width_m, "M"),
    "base_offset": _Option("base plate above the joint axes, m", STUDY_LINK.base_offset_m, "M"),
    "pressure_pa": _Option("inflation, Pa", STUDY_LINK.pressure_pa, "PA"),
    "dof": _Option("driven joints", STUDY_LINK.joints, None, int, (1, 2)),
    "rows": _Option("rows of markers", STUDY_LINK.layout.rows, "N", int),
    "corners": _Option("markers in a row", STUDY_LINK.layout.corners, "N", int),
    "mounting": _Option("mounting", STUDY_LINK.gravity.mounting, None, str, tuple(DIRECTIONS)),
    "effective_weight": _Option("part of the weight that the balloon leaves", 1.0, "PART"),
    "servo": _Option("servo", STUDY_LINK.servo.model, None, str, tuple(PRESETS)),
    "largest_payload_kg": _Option("largest payload, kg", "what the servo carries", "KG"),
}
"""Options that the terminal asks for, in this order."""


def configure(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("link", type=Path, metavar="LINK.toml", help="file to write")
    for name, (words, default, metavar, kind, choices) in _ASKED.items():
        add(
            "--" + name.replace("_", "-"), type=kind, metavar=metavar, choices=choices or None,
            help=f"{words} ({default})",
        )  # fmt: skip
    add("--mass", type=float, metavar="KG", help="of the link, weighed (estimated)")
    add("--tip-mass", type=float, metavar="KG", help="of the hardware at its tip (estimated)")
    add("--name", default="link", help="for people")
    add("--force", action="store_true", help="write over a file that exists")


def run(args: argparse.Namespace) -> int:
    """Ask for values if no option is set, check, write, and print the consequences."""
    if args.link.exists() and not args.force:
        raise InputError(args.link, "exists", "name another file, or add --force")
    chosen = any(getattr(args, key) is not None for key in _ASKED)
    if not chosen and not args.json and sys.stdin.isatty() and sys.stdout.isatty():
        _ask(args)
    link = _described(args)
    scale = LinkScale(link)
    args.link.parent.mkdir(parents=True, exist_ok=True)
    args.link.write_text(link_toml(link, scale.mass_kg, scale.tip_mass_kg), encoding="utf-8")
    used, mode_hz = scale.holding_of_limit, scale.first_mode_rad_s / (2 * math.pi)
    facts = {
        "link": str(args.link), "markers": link.layout.count, "mass_kg": scale.mass_kg,
        "payload_kg": link.payload_kg, "first_mode_hz": mode_hz,
        "holding_torque_nm": scale.holding_nm, "holding_torque_of_limit": used,
    }  # fmt: skip
    text = (
        f"{args.link}: {link.length_m:g} m × {link.width_m:g} m, {link.layout.count} markers, "
        f"{link.gravity.mounting}, {link.servo.model}; about {scale.mass_kg:.2f} kg, first mode "
        f"{mode_hz:.1f} Hz, payload up to {link.payload_kg:g} kg"
    )
    if used > RECOMMENDED_TORQUE:
        what = "a fifth is recommended" if used < 1 else "it cannot hold it: take a stronger one"
        text += (
            f"\nwarning: held within 30° it needs {scale.holding_nm:.2f} N·m, {used:.0%} of what "
            f"the servo has; {what}"
        )
    emit(args, facts, text)
    return DONE


def _ask(args: argparse.Namespace) -> None:
    """Ask for every option; a wrong answer is reported and asked for again."""
    try:
        for key, option in _ASKED.items():
            if key == "effective_weight" and args.mounting != "balloon":
                continue
            choices = f", one of {', '.join(map(str, option.choices))}" if option.choices else ""
            question = f"{option.words}{choices} [{option.default}]: "
            while (answer := input(question).strip()) and (wrong := _set(args, key, answer)):
                print(wrong)
    except EOFError:
        print()
        raise InputError(
            args.link, "is not written, the answers end before the last question",
            "answer all of them, an empty line takes the value in brackets, or give options",
        ) from None  # fmt: skip
    except KeyboardInterrupt:
        print()
        raise


def _set(args: argparse.Namespace, key: str, answer: str) -> str:
    """Set an option to an answer; return what is wrong with it, or nothing."""
    option = _ASKED[key]
    try:
        value = option.kind(answer)
    except ValueError:
        return f"{answer!r} is no {'whole ' if option.kind is int else ''}number"
    if option.choices and value not in option.choices:
        return f"{answer!r} is not one of {', '.join(map(str, option.choices))}"
    setattr(args, key, value)
    try:
        check_link(_described(args), args.link)
    except InputError as error:
        setattr(args, key, None)
        return f"{error.what}; {error.remedy}"
    return ""


def _described(args: argparse.Namespace) -> LinkDescription:
    """Link of the options; omitted values are the study's."""
    value = {key: option.default for key, option in _ASKED.items()}
    value |= {key: v for key, v in vars(args).items() if key in value and v is not None}
    link = LinkDescription(
        name=args.name, length_m=value["length"], width_m=value["width"], section=value["section"],
        base_offset_m=value["base_offset"], joints=value["dof"], pressure_pa=value["pressure_pa"],
        mass_kg=args.mass, tip_mass_kg=args.tip_mass, payload_kg=args.largest_payload_kg or 0.0,
        servo=LinkServo(model=value["servo"]),
        gravity=LinkGravity(mounting=value["mounting"], effective_weight=value["effective_weight"]),
    )  # fmt: skip
    rows, corners = value["rows"], value["corners"]
    if not (1 <= rows <= 99 and 1 <= corners <= 99):
        raise InputError("--rows, --corners", f"are {rows} and {corners}", "give 1 to 99")
    heights = tuple(round(link.length_m * k / rows, 6) for k in range(1, rows + 1))
    places = _corners_m(corners, link.marker_width_m)
    link = msgspec.structs.replace(link, markers=MarkerLayout(heights, places))
    check_link(link, args.link)
    if args.largest_payload_kg is None:
        link = msgspec.structs.replace(link, payload_kg=_payload_kg(link))
    return link


def _corners_m(count: int, width_m: float) -> tuple[tuple[float, float], ...]:
    """Positions of the markers of a row: the corners, or two opposite ones, or a ring."""
    square = square_corners_m(width_m)
    if count in (1, 2, 4):
        return {1: ((0.0, 0.0),), 2: (square[0], square[3]), 4: square}[count]
    ring = [2 * math.pi * k / count for k in range(count)]
    half = width_m / 2
    return tuple((round(half * math.cos(a), 6), round(half * math.sin(a), 6)) for a in ring)


def _payload_kg(link: LinkDescription) -> float:
    """Largest payload with which the servo holds the link within 30° by a fifth of its torque.

    In steps of 50 g; the study's payload for a link that carries no weight.
    """
    empty_nm, one_kg_nm = (
        LinkScale(msgspec.structs.replace(link, payload_kg=kg)).holding_nm for kg in (0.0, 1.0)
    )
    if one_kg_nm <= empty_nm:
        return STUDY_LINK.payload_kg
    spare_nm = RECOMMENDED_TORQUE * link.preset.torque_limit_nm - empty_nm
    return max(0.05 * int(spare_nm / (one_kg_nm - empty_nm) / 0.05 + 1e-9), 0.0)


_MEANINGS = {
    "gear": "turns of the motor per turn of the output",
    "torque_constant_nm_a": "torque at the output per ampere",
    "coulomb_friction_nm": "friction without load",
    "viscous_friction_nm_s_rad": "friction per speed",
    "load_friction": "friction per transmitted torque",
    "rotor_inertia_kg_m2": "inertia of the rotor, times the gear squared",
    "backlash_rad": "play at the output",
    "current_limit_a": "largest current",
    "speed_limit_rad_s": "speed without load",
    "mass_kg": "of the servo",
}


def link_toml(link: LinkDescription, mass_kg: float, tip_mass_kg: float) -> str:
    """Return the text of a link's file.

    `mass_kg`, `tip_mass_kg`: estimates that replace missing masses of the link.
    """
    gravity, layout = link.gravity, link.layout
    rows = [
        ("schema", link.schema, ""),
        ("name", link.name, "for people"),
        ("joints", link.joints, "driven joints, 1 or 2"),
        ("length_m", link.length_m, "base plate to last marker row"),
        ("width_m", link.width_m, "side or diameter of the section"),
        ("section", link.section, "square or round"),
        ("base_offset_m", link.base_offset_m, "base plate above the joint axes"),
        ("pressure_pa", link.pressure_pa, "inflation"),
        ("payload_kg", round(link.payload_kg, 6), "largest payload"),
    ]
    weighed = [
        ("mass_kg", link.mass_kg, mass_kg, "of the link"),
        ("tip_mass_kg", link.tip_mass_kg, tip_mass_kg, "of the hardware at the tip"),
    ]
    direction = list(gravity.direction) if gravity.direction else None
    lines = [
        "# A link: what trial, plant, rig and robot.toml share (docs/plant/link.md). SI units.",
        *(_row(*row) for row in rows),
        *(
            _row(key, stated, f"{what}, weighed")
            if stated is not None
            else "# " + _row(key, float(f"{estimated:.3g}"), f"{what}: estimated; weigh it")
            for key, stated, estimated, what in weighed
        ),
        "",
        f"# {layout.rows} rows of {layout.corners}; the last row is at the tip.",
        "[markers]",
        _row("rows_m", list(layout.rows_m), "heights above the base plate"),
        "# x and y from the axis, in every row:",
        _row("corners_m", [list(corner) for corner in layout.corners_m], ""),
        "",
        "[gravity]",
        _row("mounting", gravity.mounting, "upright, horizontal, hanging, balloon"),
        _row("effective_weight", gravity.effective_weight, "part of the weight that is left"),
        ("" if direction else "# ")
        + _row("direction", direction or [0.0, 0.0, -1.0], "z along the link at zero angle"),
        "",
        "[servo]",
        _row("model", link.servo.model, ""),
        *(_row(key, getattr(link.preset, key), text) for key, text in _MEANINGS.items()),
        _row("source", link.preset.source, ""),
    ]
    return "\n".join(lines) + "\n"


def _row(key: str, value: Any, meaning: str) -> str:
    text = f'"{_quoted(value)}"' if isinstance(value, str) else repr(value)
    line = f"{key} = {text}"
    return f"{line:34}  # {meaning}" if meaning else line


def _quoted(text: str) -> str:
    return "".join(c for c in text if c.isprintable()).replace("\\", "\\\\").replace('"', '\\"')
