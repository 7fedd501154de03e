"""Picture of a text that was written: its strokes as wanted and as the tip drew them."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from firmware_py.display_units import POSITION
from firmware_py.goals.tip_plan import TipPlan
from models.shared.palette import BLUE, GRID
from models.shared.svg_drawing import FILE_STYLE


def draw_text(plan: TipPlan, tip_m: NDArray[np.float64], path: Path) -> None:
    """Draw the strokes of a text as SVG.

    Shapes: `tip_m` (n, 2).
    """
    desired = plan.desired_tip_m()
    with mpl.rc_context(FILE_STYLE | {"font.size": 8}):
        figure = Figure(figsize=(7.0, 2.6), layout="constrained")
        ax = figure.subplots()
        for first, after in plan.drawn:
            ax.plot(*desired[first:after].T, color=GRID, lw=5.0, solid_capstyle="round")
        for first, after in plan.drawn:
            ax.plot(*tip_m[first:after].T, color=BLUE, lw=1.2)
        ax.set(xlabel=POSITION.label("tip x"), ylabel=POSITION.label("tip y"), aspect="equal")
        figure.savefig(path, metadata={"Date": None})
