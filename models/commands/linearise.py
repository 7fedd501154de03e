"""Linearised twin as state space: the exact derivatives of one control period about rest.

The file is JSON with A, B, C, D, dt and the names of states, inputs and outputs. In Python:

    import json, control
    m = json.load(open("linear.json"))
    system = control.ss(m["A"], m["B"], m["C"], m["D"], m["dt"])

Prints the modes with their damping, and the margins of the feedback that a plan would get at this
payload. While the joints move dry friction does not depend on their speed and is left out; at rest
(--at-rest) it is as stiff as its smoothing.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import Any

import msgspec

from firmware_py.core.console import DONE, emit
from firmware_py.core.output_files import write_whole
from firmware_py.core.signals import PERIOD_S
from firmware_py.core.units import ANGLE
from firmware_py.link.link_description import STUDY_LINK
from models.plant.plant import read_plant
from models.shared.output_paths import check_output_file

EXAMPLE = (
    "dropstitch linearise --plant build/plant.json --dof 1 --payload-kg 1 --out build/linear.json"
)


def configure(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--plant", type=Path, required=True, metavar="PLANT", help="plant to linearise")
    add("--out", type=Path, required=True, metavar="FILE.json", help="file to write")
    add("--payload-kg", type=float, metavar="KG",
        help="mass at the tip (half the largest of the link, 1 of the study's)")  # fmt: skip
    add("--dof", type=int, choices=(1, 2), default=1, help="number of joints (1)")
    add("--period", type=float, default=PERIOD_S, metavar="S", help="control period (0.017)")
    add("--angle-deg", type=float, nargs="+", metavar="DEG",
        help="goals at which the arm rests, one per joint (0)")  # fmt: skip
    add("--at-rest", action="store_true", help="keep dry friction, as while the joints stand")


def run(args: argparse.Namespace) -> int:
    check_output_file(args.out, [args.plant])
    plant = read_plant(args.plant)
    half_kg = (plant.link or STUDY_LINK).payload_kg / 2
    payload_kg = half_kg if args.payload_kg is None else args.payload_kg
    angles_rad = [math.radians(angle) for angle in args.angle_deg or [0.0] * args.dof]
    system = plant.linearise(
        payload_kg, dof=args.dof, period_s=args.period, angles_rad=angles_rad,
        sliding=not args.at_rest,
    )  # fmt: skip
    # CasADi and python-control are loaded here, so that a wrong option is refused at once.
    from models.plan.feedback import design_feedback
    from models.plant.linear_twin import modes

    modes_of_twin = modes(system)
    margins = design_feedback(plant, args.dof, args.period, [payload_kg]).margins
    document: dict[str, Any] = {
        "plant_sha256": plant.sha256(), "payload_kg": payload_kg, "dof": args.dof,
        "angles_rad": angles_rad, "sliding": not args.at_rest, "dt": args.period,
        "states": system.state_labels, "inputs": system.input_labels,
        "outputs": system.output_labels,
        **{name: getattr(system, name).tolist() for name in "ABCD"},
        "modes": msgspec.to_builtins(modes_of_twin),
        "margins": [
            {"joint": joint, "gain_db": m.gain_db, "phase_rad": m.phase_rad,
             "crossover_rad_s": m.crossover_rad_s}
            for joint, (m,) in enumerate(margins, start=1)
        ],
    }  # fmt: skip
    args.out.parent.mkdir(parents=True, exist_ok=True)
    write_whole(args.out, json.dumps(document, indent=1).encode() + b"\n")
    lines = [f"{args.out}: {len(system.A)} states, {payload_kg:g} kg, {args.dof}DOF", "modes:"]
    lines += [
        f"  {m.frequency_rad_s:7.2f} rad/s, damping {m.damping:.3f}, "
        + " and ".join(f"{share:.0%}" for share in m.shares) + " of the link's bend"
        for m in modes_of_twin
    ]  # fmt: skip
    lines += [
        f"feedback of joint {joint}: gain margin {m.gain_db:.1f} dB, phase margin "
        f"{ANGLE.text(m.phase_rad)}, crossover {m.crossover_rad_s:.1f} rad/s"
        for joint, (m,) in enumerate(margins, start=1)
    ]
    emit(args, document, "\n".join(lines))
    return DONE
