"""Time of one step of the observer FMU at rest beside one in motion.

On the robot it is the cost of a tick at rest. Two instances of the same FMU take their steps in
turn, so that a change of the machine's speed affects both. One moves on; the other moves for 300
steps and then rests at zero for 10 s before the measurement, in which time decaying states pass the
range of subnormal numbers.

Exit 1 if a step at rest takes more than 1.1 times a step in motion (median).

    python -m bench.observer_at_rest
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.console import DONE, NEGATIVE
from firmware_py.inference.fmu_instance import FmuInstance
from firmware_py.signals import PERIOD_S
from fmu.fmu_builder import build_fmu
from models.plant.plant import read_plant
from models.plant.step_model import StepModel, names

LIMIT: Final = 1.1
MOVING_STEPS: Final = 300
RESTING_STEPS: Final = 600


class _Contender:
    """Instance of the observer whose inputs follow a sinusoid until it rests."""

    def __init__(self, path: Path, model: StepModel) -> None:
        self._fmu = FmuInstance(path)
        self._inputs = self._fmu.channel(names(model.inputs))
        self._count = 0
        self.moves = True

    def step(self) -> int:
        """Take one step; return its time in ns, without that of setting the inputs."""
        self._inputs.values[:] = 0.3 * np.sin(0.02 * self._count) if self.moves else 0.0
        self._inputs.send()
        self._count += self.moves
        start_ns = time.perf_counter_ns()
        self._fmu.step(PERIOD_S)
        return time.perf_counter_ns() - start_ns


def rest_times_us(dof: int, count: int) -> NDArray[np.float64]:
    """Measure steps in motion and at rest, shape (count, 2), in µs."""
    model = read_plant().step_model(dof, "observer")
    with TemporaryDirectory(prefix="dropstitch-") as scratch:
        path = build_fmu(model, Path(scratch) / "observer.fmu")
        moving, resting = _Contender(path, model), _Contender(path, model)
        for contender in (moving, resting):
            for _ in range(MOVING_STEPS):
                contender.step()
        resting.moves = False
        for _ in range(RESTING_STEPS):
            resting.step()
        return np.array([(moving.step(), resting.step()) for _ in range(count)]) / 1e3


def main(argv: list[str] | None = None) -> int:
    """Measure both observers; print their medians, and the ratios as one line of JSON."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.observer_at_rest", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("--steps", type=int, default=4000, help="steps of each to time (4000)")
    args = parser.parse_args(argv)
    met, ratios = True, {}
    for dof in (1, 2):
        moving_us, resting_us = np.median(rest_times_us(dof, args.steps), axis=0)
        ratio = ratios[f"ratio_{dof}dof"] = float(resting_us / moving_us)
        met = met and ratio <= LIMIT
        print(
            f"{dof}DOF: moving {moving_us:.1f} µs, at rest {resting_us:.1f} µs, "
            f"ratio {ratio:.2f} (at most {LIMIT})",
            file=sys.stderr,
        )
    print(json.dumps(ratios))
    return DONE if met else NEGATIVE


if __name__ == "__main__":
    sys.exit(main())
