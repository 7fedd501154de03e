"""Build an SSP package of twin, observer and a controller that moves the tip along a sinusoid.

Its FMUs are of FMI 2.0, which tools for SSP support.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from firmware_py.core.console import DONE, Progress, emit
from firmware_py.core.errors import InputError
from firmware_py.core.units import FILE_SIZE

EXAMPLE = "dropstitch fmu ssp build/bundle_1dof --plant build/plant.json --out build/link_1dof.ssp"


def configure(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("bundle", type=Path, metavar="BUNDLE", help="directory that 'dropstitch train' wrote")
    add("--plant", type=Path, metavar="PLANT", help="plant document (the bundle's plant.json)")
    add("--out", type=Path, required=True, metavar="FILE", help="the .ssp file")
    add(
        "--payload-kg", type=float, metavar="KG",
        help="mass at the twin's tip in kg (half of the link's largest: 1 for the study's)",
    )  # fmt: skip
    add(
        "--platforms", default="x86_64-linux", metavar="NAMES",
        help="platforms of the FMUs, see 'dropstitch fmu build' (x86_64-linux)",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    from firmware_py.inference.manifest import read_bundle_files
    from fmu.fmpy_run import usual_payload_kg
    from fmu.fmu_models import read_parts
    from fmu.packaging import platform_names
    from fmu.ssp import PATHS, build_ssp
    from models.bundle.plant import compare_with_bundle
    from models.plant.parameter import check_payload

    if args.out.suffix != ".ssp":
        raise InputError(
            f"--out {args.out}", "does not end in .ssp", "use a name like link_1dof.ssp"
        )
    platforms = platform_names(args.platforms)
    files = read_bundle_files(args.bundle)
    dof = files.manifest.dof
    twin, observer = (
        read_parts(kind, dof, args.bundle, args.plant) for kind in ("twin", "observer")
    )
    if args.plant:
        compare_with_bundle(twin.required_plant(), args.plant, files, "this package")
    payload_kg = usual_payload_kg(twin) if args.payload_kg is None else args.payload_kg
    check_payload(payload_kg, link=twin.required_plant().link)
    progress = Progress("fmu ssp", len(PATHS) + 1)
    progress.begin("composing the models")
    build_ssp(
        twin, observer, args.out, payload_kg=payload_kg, platforms=platforms,
        report=progress.step,
    )  # fmt: skip
    progress.step("packed")
    size = args.out.stat().st_size
    emit(
        args,
        {
            "dof": dof, "payload_kg": payload_kg, "path": str(args.out), "bytes": size,
            "platforms": list(platforms),
        },
        f"{args.out}: twin with {payload_kg:g} kg, observer and controller, {dof}DOF, "
        f"{FILE_SIZE.number(size)} kB",
    )  # fmt: skip
    return DONE
