"""FMU of a plant in a plain C host, and its two interface types side by side.

    python -m bench.fmu_host --dof 2

Steps the twin's library in `fmu_host.c`, which is also an example of such a host. Then the tip in
Model Exchange (CVode, 1e-9) beside Co-Simulation over 10 s. Prints JSON; times are those of the
processor. `run_in_host` also runs the library of another platform, under Wine or qemu-user: the
host prints 17 digits, so that platforms can be compared bit by bit.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final
from xml.etree import ElementTree as ET

import fmpy
import numpy as np
from numpy.typing import NDArray

from firmware_py.core.console import DONE
from firmware_py.core.errors import DropstitchError, InputError
from firmware_py.core.motion import Motion
from firmware_py.core.signals import PERIOD_S, tip_names
from fmu.fmu_builder import HEADERS, build_fmu
from fmu.packaging import HOST, PLATFORMS
from models.plant.plant import NOMINAL, read_plant
from models.plant.step_model import names
from models.shared.c_compiler import compile_program

Array = NDArray[np.float64]

PAYLOAD_KG: Final = 1.0
EXCHANGE_S: Final = 10.0
ROUNDS: Final = 9

_EMULATORS: Final[Mapping[str, Sequence[str]]] = {
    HOST: (),
    "x86_64-windows": ("wine",),
    "aarch64-linux": ("qemu-aarch64", "-L", "/usr/aarch64-linux-gnu"),
}
"""Command that runs a platform's programs on x86-64 Linux. The folder with the C library is that of
Debian's package libc6-arm64-cross."""


def emulator_of(platform: str) -> Sequence[str] | None:
    """Return the command that runs a platform's programs here; None if there is none."""
    command = _EMULATORS.get(platform)
    if command is None or (command and not shutil.which(command[0])):
        return None
    folders = [part for part in command if part.startswith("/")]
    return command if all(Path(folder).is_dir() for folder in folders) else None


def run_in_host(
    fmu: Path,
    platform: str,
    u: Array,
    step_s: float,
    outputs: Sequence[str],
    directory: Path,
    rounds: int = 0,
) -> list[str]:
    """Step an FMI 3.0 FMU in the C host; return n + 1 lines of outputs with 17 digits.

    Shapes: `u` (n, inputs). Row k drives step k; the first also serves the initialization. With
    `rounds` one more line holds the time of a step in µs.
    """
    emulator = emulator_of(platform)
    if emulator is None:
        raise InputError(f"platform {platform}", "cannot be run here", "install Wine or qemu-user")
    with zipfile.ZipFile(fmu) as archive:
        root = ET.fromstring(archive.read("modelDescription.xml"))
        name = root.find("CoSimulation").attrib["modelIdentifier"]
        suffix = PLATFORMS[platform].suffix
        library = directory / f"{name}{suffix}"
        try:
            library.write_bytes(archive.read(f"binaries/{platform}/{name}{suffix}"))
        except KeyError:
            raise InputError(fmu, f"has no library for {platform}", "build it with it") from None
    program = compile_program(
        Path(__file__).with_suffix(".c"), directory / f"fmu_host_{platform}.exe",
        include=[HEADERS], target=PLATFORMS[platform].target,
    )  # fmt: skip
    asked = [str(library), root.attrib["instantiationToken"], *([str(rounds)] if rounds else [])]
    done = subprocess.run(
        [*emulator, str(program), *asked], input=_rows(root, u, step_s, outputs),
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode:
        raise DropstitchError(f"the host refused {library.name}: {done.stderr.strip()}")
    return done.stdout.split("\n")[:-1]


def _rows(root: ET.Element, u: Array, step_s: float, outputs: Sequence[str]) -> str:
    """Input of the host: references of inputs and outputs, the step size, the rows."""
    variables = root.findall("ModelVariables/*")
    inputs = [v.attrib["valueReference"] for v in variables if v.get("causality") == "input"]
    reference = {v.attrib["name"]: v.attrib["valueReference"] for v in variables}
    lines = [inputs, [reference[name] for name in outputs], [repr(step_s)]]
    lines += [[repr(float(value)) for value in row] for row in u]
    return "".join(" ".join(line) + "\n" for line in lines)


def measure(plant: Path, dof: int) -> dict[str, Any]:
    """Time of a step of a plant's twin in the C host, and the distance of the interface types."""
    model = read_plant(plant).step_model(dof, "twin")
    count = round(EXCHANGE_S / PERIOD_S)
    goal_rad = np.tile(Motion(dof=dof).table_rad(PERIOD_S), (3, 1))[:count]
    u = np.column_stack([goal_rad, np.full(count, PAYLOAD_KG)])
    with TemporaryDirectory(prefix="dropstitch-host-") as scratch:
        fmu = build_fmu(model, Path(scratch) / "twin.fmu")
        lines = run_in_host(fmu, HOST, u, PERIOD_S, tip_names(), Path(scratch), ROUNDS)
        return {
            "step_us": float(lines[-1]),
            "exchange_m": _exchange_m(fmu, names(model.inputs), u),
        }


def _exchange_m(fmu: Path, inputs: Sequence[str], u: Array) -> float:
    """Largest distance of the tip between the interface types, goals held for a period."""
    rows = [((k + after) * PERIOD_S, *row) for k, row in enumerate(u) for after in (0, 1)]
    table = np.array(rows, [(name, float) for name in ("time", *inputs)])
    tip = {}
    for kind in ("ModelExchange", "CoSimulation"):
        run = fmpy.simulate_fmu(
            str(fmu), fmi_type=kind, input=table, stop_time=len(u) * PERIOD_S,
            output_interval=PERIOD_S, relative_tolerance=1e-9, record_events=False,
            output=tip_names(), solver="CVode",
        )  # fmt: skip
        tip[kind] = np.column_stack([run[name] for name in tip_names()])
    return float(np.linalg.norm(tip["ModelExchange"] - tip["CoSimulation"], axis=1).max())


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m bench.fmu_host", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("--plant", type=Path, default=NOMINAL)
    parser.add_argument("--dof", type=int, choices=(1, 2), default=2)
    args = parser.parse_args(argv)
    print(json.dumps(measure(args.plant, args.dof), indent=1))
    return DONE


if __name__ == "__main__":
    raise SystemExit(main())
