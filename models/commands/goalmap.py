"""Map of the goals at which the tip rests at a place, and of the first mode, over payloads.

'dropstitch run --goals --goal-map' takes it: places of the tip become goals, and all goals are
shaped so that they do not excite the first mode.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from firmware_py.console import DONE, emit
from firmware_py.documents import write_document
from firmware_py.errors import InputError
from firmware_py.inference.manifest import read_bundle_files
from firmware_py.link.link_description import STUDY_LINK
from firmware_py.safety.limits import Limits
from models.bundle.plant import compare_with_bundle
from models.commands.output_paths import check_output_file
from models.plant.plant import read_plant

EXAMPLE = (
    "dropstitch goalmap --plant build/plant.json --bundle build/bundle_2dof "
    "--out build/goalmap.json"
)


def configure(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--plant", type=Path, required=True, metavar="PLANT", help="plant to invert at rest")
    add(
        "--bundle",
        type=Path,
        required=True,
        metavar="BUNDLE",
        help="bundle of the robot: its joints and its period",
    )
    add("--out", type=Path, required=True, metavar="MAP", help="file to write")
    add("--reach", type=float, default=0.65, metavar="M", help="largest coordinate, m (0.65)")
    add("--payloads", type=float, nargs="+", metavar="KG",
        help="grid of payloads (five up to the largest of the link, 2 of the study's)")  # fmt: skip


def run(args: argparse.Namespace) -> int:
    check_output_file(args.out, [args.plant])
    files = read_bundle_files(args.bundle)
    manifest = files.manifest
    if not 0.01 <= args.reach <= 2.0:
        raise InputError("--reach", f"is {args.reach:g}", "choose 0.01 to 2")
    plant = read_plant(args.plant)
    # CasADi is loaded here, so that a wrong option is refused at once.
    from models.plan.moves import map_rest
    from models.plan.planning import PlanRequest, check_request

    payloads = tuple(args.payloads or (plant.link or STUDY_LINK).payloads_kg)
    check_request(PlanRequest(plant, manifest.dof, manifest.period_s, Limits(), payloads))
    compare_with_bundle(plant, args.plant, files, "this map")
    found = map_rest(plant, manifest.dof, manifest.period_s, payloads, args.reach)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    write_document(args.out, found)
    reached = [sum(v is not None for v in own.goals_rad[0]) for own in found.payloads]
    lines = [f"{args.out}: {len(found.places_m)} places along each axis, {found.dof}DOF"]
    lines += [
        f"  {own.payload_kg:4g} kg: {count} places, half period of the first mode "
        + ", ".join(f"{v:.3f} s" for v in own.half_period_s)
        for own, count in zip(found.payloads, reached, strict=True)
    ]
    emit(args, {"map": str(args.out), "places": reached}, "\n".join(lines))
    return DONE
