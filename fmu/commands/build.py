"""Build an FMU from a bundle and a plant.

twin: servo and link in closed loop, driven by goals, together with the predictor. predictor: the
polynomial alone. observer: the estimator of DI and payload that the robot runs. Without --out the
observer is added to the bundle, and the bundle's golden ticks and manifest are updated.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from firmware_py.core.console import DONE, Progress, emit
from firmware_py.core.errors import InputError
from firmware_py.core.input_files import resolved
from firmware_py.core.units import FILE_SIZE

if TYPE_CHECKING:
    from fmu.fmu_models import Kind

EXAMPLE = (
    "dropstitch fmu build build/bundle_1dof --plant build/plant.json --out build/twin_1dof.fmu"
)
_OBSERVER = "observer.fmu"


def configure(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("bundle", type=Path, metavar="BUNDLE", help="directory that 'dropstitch train' wrote")
    add("--plant", type=Path, metavar="PLANT", help="plant document (the bundle's plant.json)")
    add("--out", type=Path, metavar="FILE", help="the .fmu (observer: observer.fmu in the bundle)")
    add("--fmi", type=int, choices=(2, 3), default=3, help="version of the standard (3)")
    add(
        "--platforms", default="x86_64-linux", metavar="NAMES",
        help="platforms separated by commas (x86_64-linux); all for all five: x86_64-linux, "
        "aarch64-linux, x86_64-windows, x86_64-darwin, aarch64-darwin; c-code for the sources",
    )  # fmt: skip
    add(
        "--unit", choices=("twin", "predictor", "observer"), default="twin", dest="kind",
        help="kind of FMU (twin)",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    from firmware_py.inference.bundle import read_manifest
    from fmu.bundle_observer import add_observer
    from fmu.fmu_builder import build_fmu
    from fmu.packaging import SOURCE_CODE, platform_names

    kind: Kind = args.kind
    output = _output(args)
    for_robot = kind == "observer" and resolved(output) == resolved(args.bundle / _OBSERVER)
    if for_robot and args.fmi != 3:
        raise InputError("--fmi 2", "cannot run on the robot (FMI 3.0)", "omit --fmi or give --out")
    platforms = platform_names(args.platforms)
    dof = read_manifest(args.bundle).dof
    progress = Progress(f"fmu {kind}", 3 + sum(name != SOURCE_CODE for name in platforms))

    def report(phase: str) -> None:
        progress.begin(phase)  # always shown, because each phase may take many seconds
        progress.done += 1

    if for_robot:
        add_observer(args.bundle, plant=args.plant, platforms=platforms, report=report)
    else:
        build_fmu(
            args.bundle, output, kind=kind, plant=args.plant, fmi=args.fmi, platforms=platforms,
            report=report,
        )  # fmt: skip
    report("packed")
    size = output.stat().st_size
    data = {
        "unit": kind, "fmi": args.fmi, "dof": dof, "path": str(output), "bytes": size,
        "platforms": list(platforms),
    }  # fmt: skip
    emit(
        args,
        data,
        f"{output}: {kind}, {dof}DOF, FMI {args.fmi}.0, {FILE_SIZE.number(size)} kB",
    )
    return DONE


def _output(args: argparse.Namespace) -> Path:
    if args.out is None and args.kind != "observer":
        raise InputError("--out", "is missing", f"give the file name of the {args.kind} FMU")
    output: Path = args.out or args.bundle / _OBSERVER
    if output.suffix != ".fmu":
        raise InputError(f"--out {output}", "does not end in .fmu", "use a name like twin_1dof.fmu")
    if output.is_dir() or (output.parent.exists() and not output.parent.is_dir()):
        raise InputError(f"--out {output}", "cannot be written as a file", "choose another path")
    resolved(output)  # refuses a loop of links before the work begins
    return output
