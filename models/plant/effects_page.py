"""Page of the effects: meaning, sign, unit and equation of each, from the catalogue itself.

::

    python -m models.plant.effects_page docs/gap/effects.md
"""

from __future__ import annotations

import argparse
import inspect
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final, get_args

from models.plant.effects import EFFECTS
from models.plant.plant import scope_of
from models.shared.catalogue import BEYOND_THE_RIG, EVERY_EFFECT, Port

HEAD: Final = """# Effects

What each effect of the catalogue does. Written by
`python -m models.plant.effects_page docs/gap/effects.md`; do not edit. How to add an effect:
[add-an-effect.md](../plant/add-an-effect.md).

The **strength** of an effect is its first parameter: `--hide EFFECT=STRENGTH` adds it to the rig,
`--hide EFFECT:JOINT=STRENGTH` in one joint alone (effects of a servo and its sensors), and
`gap.json` states it. The **size** is the strength that one would notice on the bench; the
benchmark hides half to double of it, or a fifth ([accuracy.md](accuracy.md)).

In the equations q is the coordinate of the joint, φ and ψ are bends of the link at its root and in
its span ([link.md](../plant/link.md)), τ is a torque, i the current, K the stiffness and t the
time since the first row of the trial. Directions are those of [trials.md](../trials.md). Each
joint has separate parameters. A diagnosis fits one strength for both joints, since the servos are
alike, and also tries the effect in one servo alone. Offsets (encoder, load, current), the position
gain and effects of the bending have a strength for each joint. A payload offset is towards +x
only.
"""

TITLES: Final[dict[Port, str]] = {
    "command": "Goal and current limit",
    "servo_torque": "Servo and gear",
    "joint_torque": "Torque on the joint",
    "bend_torque": "Bending of the link",
    "stiffness": "Stiffness of the link",
    "mass": "Payload",
    "sensor": "Sensors",
}
"""Title of the section with the effects of a port."""


def effects_page() -> str:
    """Text of the page in Markdown."""
    lines = [HEAD]
    for port in get_args(Port):
        effects = {name: row for name, row in EVERY_EFFECT.items() if row.port == port}
        remarks = []
        lines += [
            f"## {TITLES[port]}\n",
            _row("effect", "strength", "size", "equation", "other parameters"),
            "|---|---|---|---|---|",
        ]
        for name, row in effects.items():
            unit = "" if row.unit == "1" else f", {row.unit}"
            only = " (loads of your own only)" if name in BEYOND_THE_RIG else ""
            size = "" if math.isnan(row.size) else f"{row.size:g}"
            equation, *rest = (inspect.getdoc(EFFECTS[name]) or "").split("\n\n")
            also = "; ".join(_further_parameters(name))
            lines.append(_row(f"`{name}`{only}", row.strength + unit, size, equation, also))
            if rest:
                paragraphs = [" ".join(line.strip() for line in p.splitlines()) for p in rest]
                remarks.append(f"- `{name}`: " + "\n  ".join(paragraphs))
        lines += ["", *remarks, ""]
    return "\n".join(lines)


def _row(*cells: str) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _further_parameters(effect: str) -> list[str]:
    """Parameters after the strength, each with its meaning, for one joint."""
    scope = scope_of("cascade", "link", 1)
    last = [scope.name(name, 1) for name in EFFECTS[effect].fitted_last]
    lines = []
    for q in EFFECTS[effect]().parameters(scope)[1:]:
        value = f"{q.value:g}" + ("" if q.unit in ("1", "1/rad") else f" {q.unit}")
        if q.role == "effect" or q.name in last:
            treatment = ""
        elif q.role == "calibration":
            treatment = f" ({value}, refitted within its prior)"
        else:
            treatment = f" (not fitted, {value})"
        lines.append(f"`{q.name}`: {q.description}{treatment}")
    return lines


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path, help="file to write")
    parser.parse_args(argv).out.write_text(effects_page(), encoding="utf-8")


if __name__ == "__main__":
    main()
