"""FMU of a plant in a C host and in FMPy, beside CasADi's code and CVode.

    python -m bench.fmu_host --dof 2

Compiles the twin of a plant with `fmu_host.c` as shipped: a step beside hand-called CasADi code,
derivatives beside a step, the memory of many instances. Then the tip in Model Exchange (CVode,
1e-9) beside Co-Simulation over 10 s. Prints JSON; times are those of the thread's processor.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import fmpy
import numpy as np

from firmware_py.core.console import DONE
from firmware_py.core.motion import Motion
from firmware_py.core.signals import PERIOD_S, tip_names
from fmu.fmu_builder import HEADERS, WRAPPER, build_fmu, core_sources
from fmu.generated_c import write_equations, write_variables
from fmu.interface import interface_of
from models.plant.plant import NOMINAL, read_plant
from models.plant.step_model import StepModel, names

FLAGS = ("-O2", "-std=c99", "-ffp-contract=off", "-fno-slp-vectorize", "-g0", "-s",
         "-fno-sanitize=undefined")  # fmt: skip
"""Those of a shipped library (`models.shared.c_compiler`) that affect the speed."""
PAYLOAD_KG: Final = 1.0
EXCHANGE_S: Final = 10.0


def c_host_figures(model: StepModel, instances: int, directory: Path) -> dict[str, Any]:
    """Compile the host with the twin's sources and run it."""
    interface = interface_of(model)
    model_c = write_equations(model, interface, directory)
    variables_c = write_variables(model, interface, "{bench}", directory)
    program = directory / "fmu_host"
    sources = [Path(__file__).with_suffix(".c"), *core_sources(3), model_c, variables_c]
    subprocess.run(
        [
            sys.executable, "-m", "ziglang", "cc", *FLAGS,
            *(f"-I{path}" for path in (WRAPPER, directory, HEADERS)),
            *map(str, sources), "-o", str(program), "-lm",
        ],
        check=True,
    )  # fmt: skip
    done = subprocess.run([program, str(instances)], check=True, capture_output=True, text=True)
    return dict(json.loads(done.stdout))


def exchange_m(model: StepModel, dof: int, directory: Path) -> float:
    """Largest distance of the tip between the interface types, goals held for a period."""
    fmu = build_fmu(model, directory / "twin.fmu")
    count = round(EXCHANGE_S / PERIOD_S)
    goal_rad = np.tile(Motion(dof=dof).table_rad(PERIOD_S), (3, 1))[:count]
    rows = [
        ((k + after) * PERIOD_S, *goal, PAYLOAD_KG)
        for k, goal in enumerate(goal_rad)
        for after in (0, 1)
    ]
    table = np.array(rows, [(name, float) for name in ("time", *names(model.inputs))])
    tip = {}
    for kind in ("ModelExchange", "CoSimulation"):
        run = fmpy.simulate_fmu(
            str(fmu), fmi_type=kind, input=table, stop_time=count * PERIOD_S,
            output_interval=PERIOD_S, relative_tolerance=1e-9, record_events=False,
            output=tip_names(), solver="CVode",
        )  # fmt: skip
        tip[kind] = np.column_stack([run[name] for name in tip_names()])
    return float(np.linalg.norm(tip["ModelExchange"] - tip["CoSimulation"], axis=1).max())


def measure(plant: Path, dof: int, instances: int) -> dict[str, Any]:
    """All figures of the twin of a plant."""
    model = read_plant(plant).step_model(dof, "twin")
    with TemporaryDirectory(prefix="dropstitch-host-") as scratch:
        found = c_host_figures(model, instances, Path(scratch))
        return found | {"exchange_m": exchange_m(model, dof, Path(scratch))}


def main(argv: Sequence[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.fmu_host", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("--plant", type=Path, default=NOMINAL)
    parser.add_argument("--dof", type=int, choices=(1, 2), default=2)
    parser.add_argument("--instances", type=int, default=100_000)
    args = parser.parse_args(argv)
    print(json.dumps(measure(args.plant, args.dof, args.instances), indent=1))
    return DONE


if __name__ == "__main__":
    sys.exit(main())
