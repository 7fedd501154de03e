"""Pictures of the README: `python -m bench.readme_images build docs/images`.

Writes link.gif from a run in the build directory, and report.png, the top of its report.html, if
Chromium is installed.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageColor, ImageDraw

from firmware_py.core.errors import InputError
from hil.report.arm import FRAMES, ArmMotion, Stroke, arm_motion, arm_strokes, frame_of
from hil.report.build_inputs import read_build
from models.shared.palette import PAPER

Array = NDArray[np.float64]

WINDOW = "1160,1230"


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


def write_arm_gif(motion: ArmMotion, path: Path, width_px: int = 600) -> None:
    """Write the moving picture as a GIF that repeats."""
    strokes, smooth = arm_strokes(motion), 2  # drawn larger and reduced, for smooth edges
    low, high = frame_of(strokes)
    scale = smooth * width_px / (high[0] - low[0])
    width, height = np.ceil(scale * (high - low)).astype(int).tolist()
    resting = Image.new("RGB", (width, height), PAPER)
    for stroke in strokes:
        if len(stroke.points) == 1:
            _draw(resting, scale * np.abs(stroke.points[0] - (low[0], high[1])), scale, stroke)
    pictures = []
    for k in range(FRAMES):
        picture = resting.copy()
        for stroke in strokes:
            if len(stroke.points) > 1:
                _draw(picture, scale * np.abs(stroke.points[k] - (low[0], high[1])), scale, stroke)
        small = picture.resize((width_px, height // smooth), Image.Resampling.LANCZOS)
        pictures.append(small.quantize(48))
    pictures[0].save(
        path, save_all=True, append_images=pictures[1:], loop=0, optimize=True,
        duration=round(1e3 * motion.duration_s / FRAMES),
    )  # fmt: skip


def _draw(picture: Image.Image, points: Array, scale: float, stroke: Stroke) -> None:
    """Draw a stroke with round ends; its opacity is that of the whole stroke."""
    mask = Image.new("L", picture.size, 0)
    brush, shade = ImageDraw.Draw(mask), round(255 * stroke.opacity)
    radius = 0.5 * scale * stroke.width_m
    every = 2 if stroke.dashed else 1
    for start, end in zip(points[:-1:every], points[1::every], strict=True):
        brush.line([*start, *end], fill=shade, width=round(2 * radius))
    for x, y in points:
        brush.ellipse([x - radius, y - radius, x + radius, y + radius], fill=shade)
    picture.paste(ImageColor.getrgb(stroke.colour), (0, 0), mask)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:3]))
