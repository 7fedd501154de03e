"""FMU of a plant in a C host: its step beside hand-called CasADi code, derivatives, instances.

`python -m bench.fmu_host --dof 2` compiles the twin of a plant with `fmu_host.c` as shipped and
prints one line of JSON. Times are those of the thread's processor, the least of nine rounds.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from fmu.fmu_builder import HEADERS, WRAPPER, core_sources
from fmu.generated_c import write_equations, write_variables
from fmu.interface import interface_of
from models.plant.plant import NOMINAL, read_plant

FLAGS = ("-O2", "-std=c99", "-ffp-contract=off", "-fno-slp-vectorize", "-g0", "-s",
         "-fno-sanitize=undefined")  # fmt: skip
"""Those of a shipped library (`models.shared.c_compiler`) that affect the speed."""


def main() -> int:
    """Compile and run the host; its exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plant", type=Path, default=NOMINAL)
    parser.add_argument("--dof", type=int, default=2)
    parser.add_argument("--instances", type=int, default=100_000)
    args = parser.parse_args()
    model = read_plant(args.plant).step_model(args.dof)
    interface = interface_of(model)
    with TemporaryDirectory(prefix="dropstitch-host-") as scratch:
        directory = Path(scratch)
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
        return subprocess.run([str(program), str(args.instances)], check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
