"""Page of a verdict: findings, measurements, pictures of the rest pose and the clocks.

The pictures are SVG that is written directly, so an import draws in milliseconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from firmware_py.display_units import ANGLE, ANGLE_ERROR, DURATION, LENGTH
from models.shared.kinematics import pointing_angles_rad
from models.shared.pages import Figure, LegendEntry, Panel, Paragraph, Section, Table
from models.shared.palette import ALARM, GRID, INK, MEASURED, MUTED, SIMULATED
from models.trials.checks.causes import SHAPE
from models.trials.checks.motion import link_direction
from models.trials.checks.pose import RestPose
from models.trials.checks.verdict import ImportVerdict
from models.trials.clock import Synchronisation
from models.trials.origin import origin_notice, origins_of
from models.trials.trial import Array


def write_verdict(verdict: ImportVerdict, directory: Path) -> Path:
    """Write the page of a verdict."""
    from models.shared.pages import render_page  # loads Jinja

    warned = verdict.word == "warned"
    lead = Paragraph("Imported, with warnings." if warned else f"The import was {verdict.word}.")
    directory.mkdir(parents=True, exist_ok=True)
    path = directory / f"{verdict.name}.html"
    trial = verdict.trial
    notices = [origin_notice(origins_of([trial]))] if trial is not None else []
    page = render_page(f"Import of {verdict.name}", [*notices, lead], verdict_sections(verdict))
    path.write_text(page, encoding="utf-8")
    return path


def verdict_sections(verdict: ImportVerdict) -> list[Section]:
    """Sections of the page of a verdict: findings, measurements, pictures."""
    found = [(f.level, f.text, f.remedy) for f in verdict.findings]
    parts: list[Any] = [
        Table("", ("Level", "What", "Remedy"), found) if found else Paragraph("Every check passed.")
    ]
    sections = [Section("findings", "Findings", parts)]
    sections.append(
        Section("measures", "Measures", [Table("", ("Measure", "Value"), _measures(verdict))])
    )
    panels = _panels(verdict)
    if panels:
        legend = (
            LegendEntry(MEASURED, "measured"),
            LegendEntry(SIMULATED, "nominal, or the servo"),
        )
        sections.append(Section("pictures", "Pictures", [Figure("", "", panels, legend=legend)]))
    return sections


def _measures(verdict: ImportVerdict) -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    pose, clock, trial = verdict.pose, verdict.clock, verdict.trial
    if pose is not None:
        x, y, z = (LENGTH.number(v) for v in pose.offset_m)
        rows += [
            ("offset of the origin, x, y, z", f"{x}, {y}, {z} {LENGTH.name}"),
            ("tilt at rest", ANGLE.text(pose.tilt_rad)),
            ("tip beside the vertical at rest", LENGTH.text(pose.tip_aside_m)),
            ("yaw by the corners", ANGLE.text(pose.yaw_rad)),
            ("distances, measured over nominal", f"{pose.scale:.4f}"),
            ("largest distance of a marker from its place", LENGTH.text(pose.misfit_m.max())),
            ("heights of the rows", _heights(pose)),
            ("names", pose.order or "as mapped"),
        ]  # fmt: skip
    if clock is not None:
        rows.append(("clock", clock_text(clock)))
    for gap in verdict.gaps:
        rows.append(
            (f"longest gap in {gap.file}", f"{DURATION.text(gap.length_s)} at {gap.start_s:.2f} s")
        )
    for file, step_s in verdict.steps_s.items():
        rows.append((f"step of {file}", DURATION.text(step_s, 2)))
    if trial is not None:
        rows += [
            ("rows, step", f"{len(trial)} of {DURATION.text(trial.step_s, 2)}"),
            ("rows at rest", str(trial.meta.rest_samples)),
        ]
    return rows or [("nothing", "measured")]


def _heights(pose: RestPose) -> str:
    return ", ".join(LENGTH.text(v, 0) for v in pose.row_heights_m if np.isfinite(v))


def clock_text(clock: Synchronisation) -> str:
    """Offset of the servo's clock with its error, in words."""
    text = f"servo clock {clock.offset_s:+.4f} s ± {DURATION.text(clock.error_s, 2)}"
    if clock.by != "motion":
        by_hand = f"servo clock {clock.offset_s:+.4f} s, given by hand"
        return by_hand if clock.by == "option" else text + ", by the sync signal"
    text += f", correlation {clock.correlation:.4f}"
    if clock.lag_s:
        text += f", lag of the bend {DURATION.text(clock.lag_s)} left out"
    if np.isfinite(clock.second_correlation):
        text += f"; next best {clock.second_offset_s:+.2f} s with {clock.second_correlation:.2f}"
    return text


def _panels(verdict: ImportVerdict) -> Sequence[Panel]:
    panels = []
    pose, clock, trial = verdict.pose, verdict.clock, verdict.trial
    if pose is not None:
        apart = np.linalg.norm(pose.measured_m - pose.nominal_m, axis=1)
        labels = [n if d > SHAPE.limits[1] else "" for n, d in zip(pose.names, apart, strict=True)]
        for axis in (0, 1):
            title = f"Markers at rest in the plane of {'xy'[axis]} and z"
            drawn = side_view(pose.measured_m, pose.nominal_m, axis, labels)
            panels.append(Panel(title, title + ", measured and nominal", drawn))
    seen = link_direction(trial) if trial is not None else None
    if trial is not None and seen is not None:
        direction = pointing_angles_rad(seen)
        for j in range(trial.meta.dof):
            curves = [
                Curve(trial.time_s, ANGLE.shown(direction[:, j]), MEASURED),
                Curve(trial.time_s, ANGLE.shown(trial.angle_rad[:, j]), SIMULATED),
            ]
            title = f"Direction of the first row and angle of joint {j + 1}"
            panels.append(Panel(title, title, chart(curves, "time in s", ANGLE.label("angle"))))
    if clock is not None and clock.residual is not None and clock.time_s is not None:
        residuals = ANGLE_ERROR.shown(clock.residual).T
        left = [Curve(clock.time_s, column, MEASURED) for column in residuals]
        title = "Left between the clocks, without bend"
        panels.append(Panel(title, title, chart(left, "time in s", ANGLE_ERROR.label("angle"))))
    return panels


WIDTH: Final = 420
HEIGHT: Final = 300
_LEFT, _RIGHT, _TOP, _BOTTOM = 52, 10, 12, 40
_POINTS: Final = 600
"""Most points of a curve: more than it has pixels."""


_ROW_M: Final = 0.05
"""Difference in height of markers with one label: about the height of its letters [assumed]."""


class Curve(NamedTuple):
    """Points joined by a line, or dots if `dots` is true."""

    x: Array
    y: Array
    colour: str
    dots: bool = False
    label: str = ""


def chart(curves: Sequence[Curve], x_label: str, y_label: str, equal: bool = False) -> str:
    """Draw a chart of curves with axes."""
    shown = [c for c in curves if np.isfinite(c.x + c.y).any()]
    low_x, high_x = _range([c.x for c in shown])
    low_y, high_y = _range([c.y for c in shown])
    wide, high = WIDTH - _LEFT - _RIGHT, HEIGHT - _TOP - _BOTTOM
    if equal:
        scale = max((high_x - low_x) / wide, (high_y - low_y) / high)
        middle_x, middle_y = (low_x + high_x) / 2, (low_y + high_y) / 2
        low_x, high_x = middle_x - scale * wide / 2, middle_x + scale * wide / 2
        low_y, high_y = middle_y - scale * high / 2, middle_y + scale * high / 2

    def at(x: Array, y: Array) -> tuple[Array, Array]:
        across = _LEFT + (x - low_x) / (high_x - low_x) * wide
        return across, _TOP + (high_y - y) / (high_y - low_y) * high

    parts = [f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" font-size="11" fill="{INK}">']
    for value in _ticks(low_x, high_x):
        x = at(np.array(value), np.array(low_y))[0]
        parts.append(_line(float(x), _TOP, float(x), _TOP + high))
        parts.append(_text(float(x), _TOP + high + 14, f"{value:g}", "middle"))
    for value in _ticks(low_y, high_y):
        y = at(np.array(low_x), np.array(value))[1]
        parts.append(_line(_LEFT, float(y), _LEFT + wide, float(y)))
        parts.append(_text(_LEFT - 5, float(y) + 4, f"{value:g}", "end"))
    parts += [_drawn(curve, *at(curve.x, curve.y)) for curve in shown]
    parts.append(_text(_LEFT + wide / 2, HEIGHT - 6, x_label, "middle"))
    turn = f'transform="rotate(-90 12 {_TOP + high / 2:.0f})"'
    parts.append(_text(12, _TOP + high / 2, y_label, "middle", turn))
    return "".join(parts) + "</svg>"


def side_view(measured_m: Array, nominal_m: Array, axis: int, labels: Sequence[str]) -> str:
    """Draw the markers at rest, (k, 3) each, from one side; `labels` name misplaced ones."""
    far = np.array([bool(label) for label in labels])
    rows: dict[int, list[int]] = {}  # names at one height would overlap
    for k in np.flatnonzero(far & np.isfinite(measured_m[:, 2])).tolist():
        rows.setdefault(round(float(measured_m[k, 2]) / _ROW_M), []).append(k)
    words = dict.fromkeys(range(len(labels)), "")
    for row in rows.values():
        words[max(row, key=lambda k: measured_m[k, axis])] = ", ".join(labels[k] for k in row)
    curves = [
        Curve(np.zeros(1), np.zeros(1), MUTED, True, "origin"),
        Curve(nominal_m[:, axis], nominal_m[:, 2], SIMULATED, True),
        Curve(measured_m[~far, axis], measured_m[~far, 2], MEASURED, True),
        *(
            Curve(measured_m[[k], axis], measured_m[[k], 2], ALARM, True, words[k])
            for k in np.flatnonzero(far).tolist()
        ),
    ]
    return chart(curves, f"{'xy'[axis]} in m", "z in m", equal=True)


def _range(values: Sequence[Array]) -> tuple[float, float]:
    finite = [v[np.isfinite(v)] for v in values]
    joined = np.concatenate(finite) if finite else np.zeros(1)
    if not len(joined):
        return 0.0, 1.0
    low, high = float(joined.min()), float(joined.max())
    margin = 0.05 * (high - low) or 0.5
    return low - margin, high + margin


def _ticks(low: float, high: float) -> list[float]:
    step = 10.0 ** np.floor(np.log10((high - low) / 2))
    for factor in (1.0, 2.0, 5.0):
        if (high - low) / (step * factor) <= 6:
            step *= factor
            break
    first, last = np.ceil(low / step), np.floor(high / step)
    return [float(round(k * step, 12)) + 0.0 for k in np.arange(first, last + 1)]


def _drawn(curve: Curve, x: Array, y: Array) -> str:
    if curve.dots:
        dots = "".join(
            f'<circle cx="{a:.1f}" cy="{b:.1f}" r="3" fill="{curve.colour}" fill-opacity="0.75"/>'
            for a, b in zip(x, y, strict=True)
            if np.isfinite(a + b)
        )
        return dots + (
            _text(float(x[0]) + 6, float(y[0]) + 4, curve.label, "start") if curve.label else ""
        )
    every = max(len(x) // _POINTS, 1)
    pieces, pen = [], "M"
    for a, b in zip(x[::every], y[::every], strict=True):
        if np.isfinite(a + b):
            pieces.append(f"{pen}{a:.1f} {b:.1f}")
            pen = "L"
        else:
            pen = "M"
    return f'<path d="{"".join(pieces)}" fill="none" stroke="{curve.colour}" stroke-width="1.2"/>'


def _line(x1: float, y1: float, x2: float, y2: float) -> str:
    return f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{GRID}"/>'


def _text(x: float, y: float, text: str, anchor: str, more: str = "") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" {more}>{escape(text)}</text>'
