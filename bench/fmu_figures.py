"""Figures of FMUs of the nominal plant, each measured by a subcommand; prints one line of JSON.

exchange:  largest distance of the tip between Model Exchange (CVode, 1e-9) and Co-Simulation
platforms: rows of a trajectory in 17 digits that differ from those of Linux on x86_64
sample:    derivative of a whole step of the observer along a direction, against that step
picture:   curves of the twin without inputs, as docs/images/fmu-example.svg
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import fmpy
import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from firmware_py.motion import Motion
from firmware_py.signals import PERIOD_S, tip_names
from fmu.fmpy_instance import FmpyInstance, FmuArchive
from fmu.fmu_builder import build_fmu
from fmu.fmu_models import FmuParts
from fmu.host.host_run import emulator_of, run_in_host
from fmu.packaging.fmu_contents import fmu_contents
from fmu.packaging.platforms import HOST
from models.plant.plant import read_plant
from models.plant.step_model import StepModel, names
from models.shared.palette import SERIES
from models.shared.svg_drawing import FILE_STYLE

PAYLOAD_KG = 1.0
DURATION_S = 10.0
ROWS = 588
"""Rows of the trajectory on each platform: 10 s."""
ROUNDS, STEPS = 15, 40
PICTURE = Path(__file__).parents[1] / "docs/images/fmu-example.svg"


def _goals(model: StepModel, dof: int, count: int) -> NDArray[np.float64]:
    goal_rad = np.tile(Motion(dof=dof).table_rad(PERIOD_S), (3, 1))[:count]
    return np.column_stack([goal_rad, np.full(count, PAYLOAD_KG)])


def exchange(dof: int, scratch: Path) -> dict[str, Any]:
    """Compare the tip of both interface types, with goals that are held for a period."""
    model = read_plant().step_model(dof, "twin")
    fmu = build_fmu(model, scratch / "twin.fmu")
    count = round(DURATION_S / PERIOD_S)
    rows = []
    for k, u in enumerate(_goals(model, dof, count)):
        rows += [(k * PERIOD_S, *u), ((k + 1) * PERIOD_S, *u)]
    table = np.array(rows, [(name, float) for name in ("time", *names(model.inputs))])
    tip = {}
    for kind in ("ModelExchange", "CoSimulation"):
        run = fmpy.simulate_fmu(
            str(fmu), fmi_type=kind, input=table, stop_time=count * PERIOD_S,
            output_interval=PERIOD_S, relative_tolerance=1e-9, record_events=False,
            output=tip_names(), solver="CVode",
        )  # fmt: skip
        tip[kind] = np.column_stack([run[name] for name in tip_names()])
    distance_m = np.linalg.norm(tip["ModelExchange"] - tip["CoSimulation"], axis=1)
    return {"dof": dof, "tip_m": float(distance_m.max()), "rows": len(distance_m)}


def platforms(dof: int, scratch: Path) -> dict[str, Any]:
    """Run the libraries of other platforms that run here in the C host, by Wine and qemu-user."""
    model = read_plant().step_model(dof, "twin")
    others = [name for name in ("aarch64-linux", "x86_64-windows") if emulator_of(name)]
    fmu = build_fmu(model, scratch / "twin.fmu", platforms=(HOST, *others))
    u = _goals(model, dof, ROWS)
    runs = {
        name: run_in_host(fmu, name, u, PERIOD_S, names(model.outputs), scratch)
        for name in (HOST, *others)
    }
    differ = {
        name: sum(a != b for a, b in zip(runs[name], runs[HOST], strict=True)) for name in others
    }
    return {"dof": dof, "rows": len(runs[HOST]), "differ": differ, "others": len(others)}


def sample(dof: int, scratch: Path) -> dict[str, Any]:
    """Time the derivative of a step beside the step, in turn; both by FMPy."""
    model = read_plant().step_model(dof, "observer")
    with FmuArchive(build_fmu(model, scratch / "observer.fmu")) as archive:
        table = {v.name: v.valueReference for v in archive.description.modelVariables}
        unknowns = [table[f"states.{name}"] for name in names(model.states)]
        knowns = [*unknowns, *(table[name] for name in names(model.inputs))]
        with archive.instance() as steps, archive.instance("ModelExchange") as events:
            for instance in (steps, events):
                instance.initialize({f"angle_{j}_rad": 0.3 for j in range(1, dof + 1)})
            ones = [1.0] * len(knowns)

            def derivative() -> object:
                return events.fmu.getDirectionalDerivative(unknowns, knowns, ones)

            times_us = [(_time_us(_stepping(steps)), _time_us(derivative)) for _ in range(ROUNDS)]
    step_us, derivative_us = np.min(times_us, axis=0)
    return {"dof": dof, "step_us": step_us, "ratio": derivative_us / step_us}


def picture(dof: int, scratch: Path) -> dict[str, Any]:
    """Draw what a tool shows that simulates the twin without inputs."""
    parts = FmuParts("twin", dof, read_plant(), None)
    model = parts.required_plant().step_model(dof, "twin")
    example = fmu_contents(parts, model, 3).example
    fmu = build_fmu(model, scratch / "twin.fmu", example=example)
    shown = ["angle_1_rad", "current_1_a", "tip_x_m", "di"]
    run = fmpy.simulate_fmu(str(fmu), output=shown, start_values={"payload_kg": PAYLOAD_KG})
    run = run[::4]
    with plt.rc_context({**FILE_STYLE, "svg.hashsalt": "fmu"}):
        figure, axes = plt.subplots(2, 2, figsize=(8.0, 4.0), sharex=True, layout="constrained")
        for axis, name, colour in zip(axes.ravel(), shown, SERIES, strict=False):
            axis.plot(run["time"], run[name], color=colour, lw=1.2)
            axis.set_title(name, fontsize="small")
        for axis in axes[-1]:
            axis.set_xlabel("time in s")
        figure.savefig(PICTURE, format="svg", metadata={"Date": None})
        plt.close(figure)
    return {"path": str(PICTURE), "rows": len(run)}


def _stepping(instance: FmpyInstance) -> Callable[[], object]:
    return lambda: instance.step(PERIOD_S)


def _time_us(call: Callable[[], object]) -> float:
    start_ns = time.thread_time_ns()
    for _ in range(STEPS):
        call()
    return (time.thread_time_ns() - start_ns) / 1e3 / STEPS


def main() -> int:
    """Measure one figure."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    figures = {"exchange": exchange, "platforms": platforms, "sample": sample, "picture": picture}
    parser.add_argument("figure", choices=list(figures))
    parser.add_argument("--dof", type=int, choices=(1, 2), default=1)
    args = parser.parse_args()
    with TemporaryDirectory(prefix="dropstitch-") as scratch:
        print(json.dumps(figures[args.figure](args.dof, Path(scratch))))
    return 0


if __name__ == "__main__":
    sys.exit(main())
