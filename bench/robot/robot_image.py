"""Size of the wheel and start-up times of the robot image.

    python -m bench.robot.robot_image

Prints JSON. Times are the best of several fresh processes on this machine.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

ROOT: Final = Path(__file__).parents[2]
REPEATS: Final = 7


def main() -> None:
    """Build the wheel, start fresh interpreters, print."""
    with TemporaryDirectory() as scratch:
        command = ["-m", "hatchling", "build", "-t", "wheel", "-d", scratch]
        subprocess.run([sys.executable, *command], cwd=ROOT, check=True, capture_output=True)
        (wheel,) = Path(scratch).glob("*.whl")
        wheel_bytes = wheel.stat().st_size
    bare_s = fastest_start(["-c", "pass"])
    figures = {
        "wheel_bytes": wheel_bytes,
        "help_s": fastest_start(["-m", "firmware_py", "--help"]),
        "loop_import_s": fastest_start(["-c", "import firmware_py.loop"]) - bare_s,
        "bare_s": bare_s,
    }
    print(json.dumps(figures, indent=1))


def fastest_start(arguments: list[str]) -> float:
    """Shortest duration of a fresh interpreter with these arguments, in s."""
    durations = []
    for _ in range(REPEATS):
        start_s = time.perf_counter()
        subprocess.run([sys.executable, *arguments], cwd=ROOT, check=True, capture_output=True)
        durations.append(time.perf_counter() - start_s)
    return min(durations)


if __name__ == "__main__":
    main()
