"""Peak memory and time of every reader on files of 100 MB, valid and hostile ones.

    python -m bench.files --out build/bench
    python -m bench.files --only table.mat log.mcap

Each file is read by a process of its own: imports by the command, other files by their reader.
Prints a table and writes OUT/files.json. Exit 1 if one takes more than 500 MB or ends otherwise
than by success or one sentence.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, NamedTuple

from bench.files.file_filling import STEP_S, angle_rad
from bench.files.large_files import LARGE_FILES
from firmware_py.console import DONE, NEGATIVE
from firmware_py.display_units import DATA_SIZE

MOST_BYTES: Final = 500_000_000
KINDS: Final = {
    "table.csv": "table", "table.json": "table", "table.mat": "table", "log.mcap": "recording",
    "take.csv": "motive", "take.c3d": "c3d", "bag": "rosbag",
}  # fmt: skip
READERS: Final = {
    "trial.csv": "from models.trials.trial_files import read_trial as read",
    "map.toml": "from models.trials.importers.mapping import read_mapping as read",
    "plant.json": "from models.plant.plant import read_plant as read",
    "plan.json": "from firmware_py.goals.tip_plan import read_tip_plan as read",
    "golden.npz": "from firmware_py.inference.golden import read_golden\n"
                  "read = lambda path: read_golden(path, 1)",
    "predictor.onnx": "from firmware_py.inference.predictor import OnnxPredictor\n"
                      "read = lambda path: OnnxPredictor(path, 1)",
    "observer.fmu": "from firmware_py.inference.fmu_file import open_fmu as read",
}  # fmt: skip
_CALL: Final = """
import sys
from pathlib import Path
from firmware_py.errors import InputError
try:
    read(Path(sys.argv[1]))
except InputError as error:
    sys.exit(str(error) if str(error).isprintable() else "")
"""
CONDITIONS: Final = """\
schema = 1
source = "measured"
dof = 1
payload_kg = 1.0
pressure_pa = 41300.0
trial = 1
motion = "sinusoid"
period_s = 10.0
amplitude_rad = 0.3
base_offset_m = 0.06
link_length_m = 0.95
link_width_m = 0.15
"""
SERVO: Final = "time_s,goal_1_rad,angle_1_rad,current_1_a\n"
MAP: Final = f"""\
effort_unit = "mA"
[trial]
{CONDITIONS}
[topics]
"/joints" = "joints"
"/goals" = "goals"
[frame]
up = "z"
[columns]
goal_1_rad = {{ from = "angle_1_rad" }}
"""


class FileReading(NamedTuple):
    """One file and its end."""

    file: str
    content: str
    size_bytes: int
    ended: str  # "used", "refused" or "failed"
    peak_bytes: int  # Largest resident size of the process that read it, or of a child of it
    cpu_s: float  # Processor time of both
    said: str  # Last line that it printed


def read_file(file: str, content: str, folder: Path) -> FileReading:
    """Write a file in one process and read it in another."""
    path = folder / file
    subprocess.run(
        [sys.executable, "-m", "bench.files", "--write", file, content, str(path)], check=True
    )
    size = sum(p.stat().st_size for p in (path.iterdir() if path.is_dir() else [path]))
    if file in KINDS:
        (folder / "import.toml").write_text(MAP, encoding="utf-8")
        (folder / "servo.csv").write_text(servo_log(), encoding="utf-8")
        command = ["-m", "models", "import", str(path), "--as", KINDS[file], "--name", "trial"]
        command += ["--map", str(folder / "import.toml"), "--out", str(folder / "out")]
        if KINDS[file] in ("motive", "c3d"):
            command += ["--servo", str(folder / "servo.csv"), "--offset", "0"]
    else:
        (folder / "trial.toml").write_text(f"rest_samples = 3\n{CONDITIONS}", encoding="utf-8")
        command = ["-c", READERS[file] + _CALL, str(path)]
    with (folder / "said").open("w+b") as said:
        child = subprocess.Popen([sys.executable, *command], stdout=said, stderr=said)
        _, status, usage = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        said.seek(0)
        lines = said.read().decode("utf-8", "replace").strip().splitlines() or [""]
    if child.returncode == 0:
        ended = "used"
    else:
        refused = child.returncode in (1, 2) and len(lines) == 1 and lines[0].endswith(".")
        ended = "refused" if refused else "failed"
    cpu_s = usage.ru_utime + usage.ru_stime
    return FileReading(file, content, size, ended, 1024 * usage.ru_maxrss, cpu_s, lines[-1])


def servo_log() -> str:
    """Servo's log of half an hour, for motion captures that have none."""
    rows = ((k * STEP_S, angle_rad(k)) for k in range(30_000))
    return SERVO + "".join([f"{time_s:.3f},{a:.6f},{a:.6f},0.1\n" for time_s, a in rows])


def main() -> int:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(prog="python -m bench.files", description=__doc__)
    parser.add_argument("--only", nargs="+", metavar="FILE", default=[])
    parser.add_argument("--out", type=Path)
    parser.add_argument("--write", nargs=3, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.write:
        LARGE_FILES[args.write[0]][args.write[1]](Path(args.write[2]))
        return DONE
    readings = []
    print(f"{'file':16}{'content':18}{'MB':>6}  {'end':8}{'peak MB':>8}{'CPU s':>8}", flush=True)
    for file, contents in LARGE_FILES.items():
        for content in contents if not args.only or file in args.only else ():
            with TemporaryDirectory(prefix="dropstitch-files-") as folder:
                one = read_file(file, content, Path(folder))
            readings.append(one)
            print(
                f"{file:16}{content:18}{DATA_SIZE.number(one.size_bytes, 1):>6}  {one.ended:8}"
                f"{DATA_SIZE.number(one.peak_bytes):>8}{one.cpu_s:8.1f}  {one.said[:110]}",
                flush=True,
            )  # fmt: skip
    peak = max(one.peak_bytes for one in readings)
    failed = [one for one in readings if one.ended == "failed"]
    if args.out:
        args.out.mkdir(parents=True, exist_ok=True)
        result = {"peak_mb": peak / 1e6, "failed": len(failed), "files": len(readings),
                  "slowest_s": max(one.cpu_s for one in readings),
                  "readings": [one._asdict() for one in readings]}  # fmt: skip
        (args.out / "files.json").write_text(json.dumps(result, indent=1), encoding="utf-8")
    print(f"{len(readings)} files, peak {DATA_SIZE.number(peak)} MB, {len(failed)} failed")
    return NEGATIVE if failed or peak > MOST_BYTES else DONE


if __name__ == "__main__":
    sys.exit(main())
