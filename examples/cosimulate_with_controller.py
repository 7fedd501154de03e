"""Co-simulate the twin FMU in FMPy with your controller, which holds the tip in place.

The payload doubles after four seconds; the controller sees the tip and moves the goal:

    python examples/cosimulate_with_controller.py
"""

import sys
import tempfile
from pathlib import Path

import fmpy
from fmpy.fmi2 import FMU2Slave

import dropstitch

PLANT = Path(__file__).resolve().parents[1] / "docs/notebooks/bundle_1dof/plant.json"
STEP_S = 0.017
WANTED_M = 0.3


def main() -> int:
    with tempfile.TemporaryDirectory() as scratch:
        file = dropstitch.build_fmu(dropstitch.read_plant(PLANT), f"{scratch}/twin.fmu", fmi=2)
        description = fmpy.read_model_description(str(file))
        reference = {v.name: v.valueReference for v in description.modelVariables}
        twin = FMU2Slave(
            guid=description.guid,
            unzipDirectory=fmpy.extract(str(file), f"{scratch}/twin"),
            modelIdentifier=description.coSimulation.modelIdentifier,
        )
        twin.instantiate()
        twin.setupExperiment(startTime=0.0)
        twin.enterInitializationMode()
        twin.setReal([reference["payload_kg"]], [0.5])
        twin.exitInitializationMode()

        goal_rad, worst_m = 0.0, 0.0
        for tick in range(round(8.0 / STEP_S)):
            time_s = tick * STEP_S
            payload_kg = 0.5 if time_s < 4.0 else 1.0
            (tip_x_m,) = twin.getReal([reference["tip_x_m"]])
            goal_rad += 1.2 * STEP_S * (WANTED_M - tip_x_m)  # integral controller
            inputs = [reference["goal_1_rad"], reference["payload_kg"]]
            twin.setReal(inputs, [goal_rad, payload_kg])
            twin.doStep(time_s, STEP_S)
            if tick % 59 == 0:
                print(f"{time_s:4.1f} s  {payload_kg} kg  tip at {tip_x_m:.3f} m")
            if time_s > 7.0:
                worst_m = max(worst_m, abs(WANTED_M - tip_x_m))
        twin.terminate()
        twin.freeInstance()
    print(f"in the last second the tip is at most {1e3 * worst_m:.1f} mm off {WANTED_M} m")
    return 0


if __name__ == "__main__":
    sys.exit(main())
