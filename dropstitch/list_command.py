"""Effects, rigs or servos that there are, one on each line.

effects: physical effects for --hide EFFECT=STRENGTH and for a plant, with the unit and the meaning
of their strength and the port where they act. rigs: structures for --rig NAME. servos: models for
--model and [[servos]].
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any, Final

from firmware_py.bus.registers import Register
from firmware_py.bus.servo_models import MODELS
from firmware_py.core.console import DONE, emit

EXAMPLE = "dropstitch list effects"

Rows = dict[str, dict[str, Any]]


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("what", choices=tuple(_ROWS), help="what to list")


def run(args: argparse.Namespace) -> int:
    """Print the list."""
    rows = _ROWS[args.what]()
    head = ["name", *next(iter(rows.values()))]
    cells = [head, *([name, *map(str, row.values())] for name, row in rows.items())]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    lines = ["  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)) for row in cells]
    emit(args, {args.what: rows}, "\n".join(line.rstrip() for line in lines))
    return DONE


def _effects() -> Rows:
    from models.plant.effects import EFFECTS
    from models.shared.catalogue import BEYOND_THE_RIG, EVERY_EFFECT

    beyond = " (in a plant only, not in the rig)"
    rows = {
        name: {
            "unit": effect.unit,
            "port": effect.port,
            "strength": effect.strength + (beyond if name in BEYOND_THE_RIG else ""),
        }
        for name, effect in EVERY_EFFECT.items()
    }
    for name in sorted(EFFECTS.keys() - EVERY_EFFECT.keys()):
        of_file = EFFECTS[name]
        strength = (*of_file.per_joint, *of_file.shared)[0]
        rows[name] = {
            "unit": strength.unit,
            "port": of_file.port,
            "strength": f"{strength.description} (not in the catalogue)",
        }
    return rows


def _rigs() -> Rows:
    from models.rig.parameters import named_structures

    return {
        name: {"purpose": rig.purpose, "summary": rig.summary}
        for name, rig in named_structures().items()
    }


def _servos() -> Rows:
    return {
        model.name: {
            "number": model.number,
            "pulses_per_turn": model.pulses_per_turn,
            "current_ma_per_lsb": round(1e3 * model.current_a_per_lsb, 3),
            "bus_watchdog": "yes" if Register.BUS_WATCHDOG in model.table else "no",
        }
        for model in MODELS.values()
    }


_ROWS: Final[dict[str, Callable[[], Rows]]] = {
    "effects": _effects, "rigs": _rigs, "servos": _servos,
}  # fmt: skip
