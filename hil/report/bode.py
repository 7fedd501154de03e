"""Bode plot: gain and phase over frequency, on a page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.units import ANGLE
from models.shared.drawing import Drawing, Line, log_axis, plot_lines
from models.shared.pages import Panel

Array = NDArray[np.float64]
Response = NDArray[np.complex128]


def bode_panels(
    frequency_hz: Array,
    curves: Sequence[tuple[Response, str]],
    about: str,
    gain_label: str | None = None,
    marks: Sequence[tuple[float, str]] = (),
) -> list[Panel]:
    """Gain and phase of `curves` (response, colour), `about` says of what.

    The gain is in dB unless it has a unit, which `gain_label` names. `marks` are frequencies in Hz
    with their colour, drawn as vertical lines.
    """
    gains = [np.abs(response) for response, _ in curves]
    phases = [ANGLE.shown(np.unwrap(np.angle(response))) for response, _ in curves]
    if gain_label is None:
        gains = [20.0 * np.log10(gain) for gain in gains]
    panels = []
    for title, values, ylabel in (
        ("Gain", gains, gain_label or "gain in dB"), ("Phase", phases, ANGLE.label("phase")),
    ):  # fmt: skip
        with Drawing() as (drawing, ax):
            for mark_hz, colour in marks:
                ax.axvline(mark_hz, color=colour, linestyle=":", linewidth=1)
            lines = zip(values, curves, strict=True)
            plot_lines(ax, [Line(frequency_hz, y, colour, width=1.2) for y, (_, colour) in lines])
            log_axis(ax, frequency_hz, "x")
            ax.set(xlabel="frequency in Hz", ylabel=ylabel)
            if title == "Phase":
                _degrees(ax)
            elif gain_label is not None:
                log_axis(ax, np.concatenate(values))
        panels.append(drawing.panel(title, f"{title} {about} over frequency."))
    return panels


def _degrees(ax: Any) -> None:
    """Ticks of a phase at multiples of 45°, or of 90° if it turns far."""
    low, high = ax.get_ylim()
    step = 45 if high - low < 300 else 90 if high - low < 700 else 180
    ax.set_yticks(np.arange(step * math.floor(low / step), high + step, step))
    ax.set_ylim(low, high)
