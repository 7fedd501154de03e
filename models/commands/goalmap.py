"""Map of the goals at which the tip rests at a place, and of the first mode, over payloads.

'dropstitch run --goals --goal-map' takes it: places of the tip become goals, and all goals are
shaped so that they do not excite the first mode of the link. A warning says where no mode stands
out, because goals cannot be shaped well then.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Final

from firmware_py.core.console import DONE, emit
from firmware_py.core.documents import write_document
from firmware_py.core.errors import InputError
from firmware_py.inference.manifest import read_bundle_files
from firmware_py.link.link_description import STUDY_LINK
from models.bundle.plant import compare_with_bundle
from models.plant.plant import read_plant
from models.shared.output_paths import check_output_file

EXAMPLE = (
    "dropstitch goalmap --plant build/plant.json --bundle build/bundle_2dof "
    "--out build/goalmap.json"
)
LEAST_SHARE: Final = 0.5
"""Share of the link's bend below which its first mode does not stand out [assumed]; 0.95 on the
link of the study."""


def configure(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--plant", type=Path, required=True, metavar="PLANT", help="plant to invert at rest")
    add("--bundle", type=Path, required=True, metavar="BUNDLE",
        help="bundle of the robot: its joints and its period")  # fmt: skip
    add("--out", type=Path, required=True, metavar="MAP", help="file to write")
    add("--reach", type=float, default=0.65, metavar="M", help="largest coordinate, m (0.65)")
    add("--payloads", type=float, nargs="+", metavar="KG",
        help="grid of payloads (five up to the largest of the link, 2 of the study's)")  # fmt: skip


def run(args: argparse.Namespace) -> int:
    check_output_file(args.out, [args.plant])
    files = read_bundle_files(args.bundle)
    dof, period_s = files.manifest.dof, files.manifest.period_s
    if not 0.01 <= args.reach <= 2.0:
        raise InputError("--reach", f"is {args.reach:g}", "choose 0.01 to 2")
    plant = read_plant(args.plant)
    # CasADi is loaded here, so that a wrong option is refused at once.
    from models.plan.plan import check_grid
    from models.plan.rest_map import map_rest

    payloads_kg = tuple(args.payloads or (plant.link or STUDY_LINK).payloads_kg)
    check_grid(plant, payloads_kg)
    compare_with_bundle(plant, args.plant, files, "this map")
    goal_map, modes = map_rest(plant, dof, period_s, payloads_kg, args.reach)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    write_document(args.out, goal_map)

    places = [sum(v is not None for v in one.goals_rad[0]) for one in goal_map.payloads]
    lines = [f"{args.out}: {len(goal_map.places_m)} places along each axis, {dof}DOF"]
    for payload_kg, count, by_joint in zip(payloads_kg, places, modes, strict=True):
        lines.append(f"  {payload_kg:4g} kg: {count} places, first mode of the link:")
        for joint, mode in enumerate(by_joint, start=1):
            share = mode.shares[0]
            lines.append(
                f"    joint {joint}: {mode.frequency_rad_s:.1f} rad/s, damping {mode.damping:.2f}, "
                f"half period {mode.half_period_s:.3f} s, {share:.0%} of the bend"
            )
            if share < LEAST_SHARE:
                print(
                    f"warning: {args.plant}: with {payload_kg:g} kg no mode of joint {joint} "
                    f"stands out; goals are shaped by one with {share:.0%} of the link's bend",
                    file=sys.stderr,
                )
    data = {
        "map": str(args.out),
        "places": places,
        "modes": [
            [{"frequency_rad_s": m.frequency_rad_s, "damping": m.damping, "share": m.shares[0]}
             for m in by_joint] for by_joint in modes
        ],
    }  # fmt: skip
    emit(args, data, "\n".join(lines))
    return DONE
