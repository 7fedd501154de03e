"""From your motion capture to a bundle for the robot: import, identify, train.

The rig makes the recordings here, with angles in degrees and currents in mA. Replace `record` and
the map by your files; docs/trials.md describes both.

    python examples/own_mocap_to_bundle.py [OUT]
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

import dropstitch

MAP = """step_s = 0.017
[trial]
dof = 1
payload_kg = {payload_kg}
pressure_pa = 41300.0
trial = 1
motion = "sinusoid"
period_s = 2.0
amplitude_rad = 0.2
base_offset_m = 0.06
link_length_m = 0.95
link_width_m = 0.15
[columns]
angle_1_rad = {{ from = "position", unit = "deg" }}
current_1_a = {{ from = "current", unit = "mA" }}
"""


def record(path: Path, payload_kg: float) -> None:
    motion = dropstitch.Motion(amplitude_rad=0.2, period_s=2.0)
    case = dropstitch.TrialCase(motion, payload_kg, trial=1)
    columns = dict(dropstitch.run_case(dropstitch.rig_named("default"), case).columns)
    columns["position"] = np.degrees(columns.pop("angle_1_rad"))
    columns["current"] = 1e3 * columns.pop("current_1_a")
    table = np.column_stack([*columns.values()])
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="")


def main(out: Path) -> int:
    out.mkdir(parents=True, exist_ok=True)
    for payload_kg in (0.0, 1.0, 2.0):
        take, map_file = out / f"take_{payload_kg:g}kg.csv", out / "map.toml"
        record(take, payload_kg)
        map_file.write_text(MAP.format(payload_kg=payload_kg), encoding="utf-8")
        print(*dropstitch.import_recordings(take, "table", out / "trials", mapping=map_file))
    trials = dropstitch.read_trials(out / "trials")
    result = dropstitch.identify(dropstitch.read_plant(), trials)
    print(result)
    print(dropstitch.train(trials, result.plant, out / "bundle", candidates=()).summary())
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())))
