"""Pictures of the README: `python -m hil.report.readme_images build docs/images`.

Writes link.gif from a run in the build directory, and report.png, the top of its report.html, if
Chromium is installed.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

from firmware_py.core.errors import InputError
from hil.report.arm import arm_motion, write_arm_gif
from hil.report.build_inputs import read_build

WINDOW = "1160,1000"


def main(build: Path, out: Path) -> None:
    motions = [motion for loop in read_build(build).loops if (motion := arm_motion(loop))]
    if not motions:
        raise InputError(build, "has no run with a log and a true tip", "run 'make demo' first")
    write_arm_gif(max(motions, key=lambda m: m.rigid_off_m), out / "link.gif")
    browser = shutil.which("chromium") or shutil.which("chromium-browser")
    if browser is None:
        print("no Chromium: report.png is as before", file=sys.stderr)
        return
    page, picture = (build / "report.html").resolve(), (out / "report.png").resolve()
    subprocess.run(
        [browser, "--headless=new", "--no-sandbox", "--hide-scrollbars", f"--window-size={WINDOW}",
         "--virtual-time-budget=2000", f"--screenshot={picture}", page.as_uri()],
        check=True, capture_output=True,
    )  # fmt: skip


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:3]))
