"""Run of tests/hitl against emulated servos, to check these tests (`make hitl-emulated`).

Arguments go to pytest. One joint by default; set DROPSTITCH_HITL_IDS and _MODEL for others.
"""

import contextlib
import os
import subprocess
import sys
from pathlib import Path

from models.plant.plant import NOMINAL

HERE = Path(__file__).parent
PRIORITY = 60
"""Above the loop's, as in software in the loop."""


def main() -> int:
    """Start the emulator, run the tests at its port, end it."""
    model = os.environ.get("DROPSTITCH_HITL_MODEL", "H54-200-S500-R")
    ids = os.environ.get("DROPSTITCH_HITL_IDS", "1").split(",")
    emulator = subprocess.Popen(
        [
            sys.executable, "-m", "dropstitch", "emulate", "--line", "pty", "--plant", str(NOMINAL),
            "--model", model, "--ids", *ids,
        ],
        stdout=subprocess.PIPE, text=True, cwd=HERE.parents[1],
    )  # fmt: skip
    assert emulator.stdout is not None
    try:
        port = emulator.stdout.readline().strip()
        if not port:
            return emulator.wait()
        with contextlib.suppress(PermissionError):  # a servo does not share its processor
            os.sched_setscheduler(emulator.pid, os.SCHED_FIFO, os.sched_param(PRIORITY))
        print(f"emulated {model}, ids {', '.join(ids)}, at {port}", flush=True)
        tests = [sys.executable, "-m", "pytest", str(HERE), *sys.argv[1:]]
        return subprocess.run(tests, env=os.environ | {"DROPSTITCH_HITL_PORT": port}).returncode
    finally:
        emulator.terminate()
        emulator.wait()


if __name__ == "__main__":
    sys.exit(main())
