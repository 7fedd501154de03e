"""Verdict on a recording, collected while it is imported, and its page.

The pictures are SVG that is written directly, so an import draws in milliseconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from firmware_py.core.errors import InputError
from firmware_py.core.units import ANGLE, ANGLE_ERROR, DURATION, LENGTH
from models.shared.kinematics import pointing_angles_rad
from models.shared.pages import (
    Figure,
    LegendEntry,
    Panel,
    Paragraph,
    Section,
    Table,
    render_page,
    write_page,
)
from models.shared.palette import ALARM, GRID, INK, MEASURED, MUTED, SIMULATED
from models.trials.checks.causes import SHAPE, ImportFinding
from models.trials.checks.motion import link_direction
from models.trials.checks.pose import RestPose
from models.trials.checks.times import Gap
from models.trials.clock import Synchronisation
from models.trials.origin import origin_notice, origins_of
from models.trials.trial import Array, Trial


@dataclass
class ImportVerdict:
    """Findings and measurements of an import, collected while it proceeds."""

    name: str
    findings: list[ImportFinding] = field(default_factory=list)
    pose: RestPose | None = None  # Pose at rest, before alignment
    # Offset between the clocks of two files, or between signals of one file
    clock: Synchronisation | None = None
    gaps: list[Gap] = field(default_factory=list)  # Longest gap of each file
    trial: Trial | None = None
    # Median step of each file before resampling
    steps_s: dict[str, float] = field(default_factory=dict)

    @property
    def refused(self) -> list[ImportFinding]:
        return [f for f in self.findings if f.level == "refused"]

    @property
    def warnings(self) -> list[ImportFinding]:
        """Findings that do not refuse the import."""
        return [f for f in self.findings if f.level == "warning"]

    @property
    def word(self) -> str:
        return "refused" if self.refused else "warned" if self.warnings else "passed"

    def refuse(self, where: Path) -> None:
        """Refuse the import if a finding does."""
        reasons = self.refused
        if reasons:
            others = "".join(f"; also: {f.text}" for f in [*reasons[1:], *self.warnings][:2])
            raise InputError(where, reasons[0].text + others, reasons[0].remedy)

    def as_json(self) -> dict[str, Any]:
        """Verdict as JSON."""
        document: dict[str, Any] = {
            "verdict": self.word,
            "findings": [f._asdict() for f in self.findings],
        }
        if self.pose is not None:
            heights_m = self.pose.row_heights_m.tolist()
            document["rest_pose"] = {
                "offset_m": self.pose.offset_m.tolist(),
                "tilt_rad": self.pose.tilt_rad,
                "tip_aside_m": self.pose.tip_aside_m,
                "yaw_rad": self.pose.yaw_rad,
                "scale": self.pose.scale,
                "largest_misfit_m": float(self.pose.misfit_m.max()),
                "row_heights_m": [None if np.isnan(v) else v for v in heights_m],
            }
        if self.gaps:
            document["longest_gap_s"] = max(gap.length_s for gap in self.gaps)
        return document


# --- page ----------------------------------------------------------------------------------------


OUTCOMES: Final = {
    "passed": "Imported. Every check passed.",
    "warned": "Imported, with warnings.",
    "refused": "Refused.",
}


def write_verdict(verdict: ImportVerdict, directory: Path) -> Path:
    """Write the page of a verdict: findings, measures, pictures."""
    lead = Paragraph(OUTCOMES[verdict.word])
    trial = verdict.trial
    notices = [origin_notice(origins_of([trial]))] if trial is not None else []
    rows = [(f.level, f.text, f.remedy) for f in verdict.findings]
    sections = [Section("measures", "Measures", [Table("", ("", "value"), _measures(verdict))])]
    if rows:
        findings = Table("", ("level", "what", "remedy"), rows)
        sections.insert(0, Section("findings", "Findings", [findings]))
    if panels := _panels(verdict):
        colours = {MEASURED: "measured", SIMULATED: "nominal, or the servo"}
        legend = tuple(LegendEntry(colour, words) for colour, words in colours.items())
        sections.append(Section("pictures", "Pictures", [Figure("", "", panels, legend=legend)]))
    path = directory / f"{verdict.name}.html"
    write_page(path, render_page(f"Import of {verdict.name}", [*notices, lead], sections))
    return path


def _measures(verdict: ImportVerdict) -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    pose, clock, trial = verdict.pose, verdict.clock, verdict.trial
    if pose is not None:
        x, y, z = (LENGTH.number(v) for v in pose.offset_m)
        heights = [LENGTH.text(v, 0) for v in pose.row_heights_m if np.isfinite(v)]
        rows += [
            ("offset of the origin, x, y, z", f"{x}, {y}, {z} {LENGTH.name}"),
            ("tilt at rest", ANGLE.text(pose.tilt_rad)),
            ("tip beside the vertical at rest", LENGTH.text(pose.tip_aside_m)),
            ("yaw by the corners", ANGLE.text(pose.yaw_rad)),
            ("distances, measured over nominal", f"{pose.scale:.4f}"),
            ("largest distance of a marker from its place", LENGTH.text(pose.misfit_m.max())),
            ("heights of the rows", ", ".join(heights)),
            ("names", pose.order or "as mapped"),
        ]  # fmt: skip
    if clock is not None:
        rows.append(("clock", clock_text(clock)))
    for gap in verdict.gaps:
        longest = f"{DURATION.text(gap.length_s)} at {gap.start_s:.2f} s"
        rows.append((f"longest gap in {gap.file}", longest))
    for file, step_s in verdict.steps_s.items():
        rows.append((f"step of {file}", DURATION.text(step_s, 2)))
    if trial is not None:
        rows += [
            ("rows, step", f"{len(trial)} of {DURATION.text(trial.step_s, 2)}"),
            ("rows at rest", str(trial.meta.rest_samples)),
        ]
    return rows or [("nothing", "measured")]


def clock_text(clock: Synchronisation) -> str:
    """Offset of the servo's clock with its error, in words."""
    text = f"servo clock {clock.offset_s:+.4f} s ± {DURATION.text(clock.error_s, 2)}"
    if clock.by != "motion":
        by_hand = f"servo clock {clock.offset_s:+.4f} s, set by hand"
        return by_hand if clock.by == "option" else text + ", by the sync signal"
    text += f", correlation {clock.correlation:.4f}"
    if clock.lag_s:
        text += f", lag of the bend {DURATION.text(clock.lag_s)} left out"
    if np.isfinite(clock.second_correlation):
        text += f"; next best {clock.second_offset_s:+.2f} s with {clock.second_correlation:.2f}"
    return text


def _panels(verdict: ImportVerdict) -> list[Panel]:
    panels = []
    pose, clock, trial = verdict.pose, verdict.clock, verdict.trial
    if pose is not None:
        far = np.linalg.norm(pose.measured_m - pose.nominal_m, axis=1) > SHAPE.limits[1]
        for axis in (0, 1):
            curves = [
                Curve(np.zeros(1), np.zeros(1), MUTED, ("origin",)),
                Curve(pose.nominal_m[:, axis], pose.nominal_m[:, 2], SIMULATED, ()),
            ]
            for chosen, colour in ((~far, MEASURED), (far, ALARM)):
                names = tuple(np.array(pose.names)[chosen]) if colour == ALARM else ()
                place_m = pose.measured_m[chosen]
                curves.append(Curve(place_m[:, axis], place_m[:, 2], colour, names))
            title = f"Markers at rest in the plane of {'xy'[axis]} and z"
            svg = chart(curves, f"{'xy'[axis]} in m", "z in m", one_scale=True)
            panels.append(Panel(title, title + ", measured and nominal", svg))
    direction = link_direction(trial) if trial is not None else None
    if trial is not None and direction is not None:
        pointing = pointing_angles_rad(direction)
        for j in range(trial.meta.dof):
            curves = [
                Curve(trial.time_s, ANGLE.shown(pointing[:, j]), MEASURED),
                Curve(trial.time_s, ANGLE.shown(trial.angle_rad[:, j]), SIMULATED),
            ]
            title = f"Direction of the first row and angle of joint {j + 1}"
            panels.append(Panel(title, title, chart(curves, "time in s", ANGLE.label("angle"))))
    if clock is not None and clock.residual is not None and clock.time_s is not None:
        residuals = ANGLE_ERROR.shown(clock.residual).T
        curves = [Curve(clock.time_s, column, MEASURED) for column in residuals]
        title = "Residual of the clocks' fit, without bend"
        panels.append(Panel(title, title, chart(curves, "time in s", ANGLE_ERROR.label("angle"))))
    return panels


# --- charts --------------------------------------------------------------------------------------

WIDTH: Final = 420
HEIGHT: Final = 300
LEFT, TOP, WIDE, HIGH = 52, 12, 358, 248
POINTS: Final = 600
"""Most points of a curve: more than it has pixels."""


class Curve(NamedTuple):
    """Points joined by a line, or dots if there are `names` of them, if only of none."""

    x: Array
    y: Array
    colour: str
    names: tuple[str, ...] | None = None


def chart(curves: Sequence[Curve], x_label: str, y_label: str, one_scale: bool = False) -> str:
    """Draw a chart of curves with axes, to one scale if both are lengths."""
    low_x, high_x = _range([c.x for c in curves])
    low_y, high_y = _range([c.y for c in curves])
    if one_scale:
        scale = max((high_x - low_x) / WIDE, (high_y - low_y) / HIGH)
        low_x, high_x = (low_x + high_x + scale * WIDE * np.array([-1, 1])) / 2
        low_y, high_y = (low_y + high_y + scale * HIGH * np.array([-1, 1])) / 2
    parts = [f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" font-size="11" fill="{INK}">']
    for value in _ticks(low_x, high_x):
        x = LEFT + (value - low_x) / (high_x - low_x) * WIDE
        parts.append(f'<path d="M{x:.1f} {TOP}v{HIGH}" stroke="{GRID}"/>')
        parts.append(_text(x, TOP + HIGH + 14, f"{value:g}", "middle"))
    for value in _ticks(low_y, high_y):
        y = TOP + (high_y - value) / (high_y - low_y) * HIGH
        parts.append(f'<path d="M{LEFT} {y:.1f}h{WIDE}" stroke="{GRID}"/>')
        parts.append(_text(LEFT - 5, y + 4, f"{value:g}", "end"))
    for curve in curves:
        across = LEFT + (curve.x - low_x) / (high_x - low_x) * WIDE
        down = TOP + (high_y - curve.y) / (high_y - low_y) * HIGH
        parts.append(_drawn(curve, np.column_stack([across, down])))
    parts.append(_text(LEFT + WIDE / 2, HEIGHT - 6, x_label, "middle"))
    turn = f'transform="rotate(-90 12 {TOP + HIGH / 2:.0f})"'
    parts.append(_text(12, TOP + HIGH / 2, y_label, "middle", turn))
    return "".join(parts) + "</svg>"


def _drawn(curve: Curve, places: Array) -> str:
    """Line or dots of a curve at its places on the page, (n, 2)."""
    visible = np.isfinite(places.sum(axis=1))
    if curve.names is not None:
        dots = [
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3" fill="{curve.colour}" fill-opacity="0.75"/>'
            for x, y in places[visible]
        ]
        words: dict[tuple[float, float], list[str]] = {}  # names at one place stand side by side
        for name, (x, y) in zip(curve.names, places.round().tolist(), strict=False):
            words.setdefault((x, y), []).append(name)
        texts = [_text(x + 6, y + 4, ", ".join(n), "start") for (x, y), n in words.items()]
        return "".join([*dots, *texts])
    rows = np.arange(0, len(places), max(len(places) // POINTS, 1))
    pen = np.where(np.concatenate([[False], visible[rows[:-1]]]), "L", "M")
    drawn = [
        f"{pen[k]}{places[row, 0]:.1f} {places[row, 1]:.1f}"
        for k, row in enumerate(rows) if visible[row]
    ]  # fmt: skip
    return f'<path d="{"".join(drawn)}" fill="none" stroke="{curve.colour}" stroke-width="1.2"/>'


def _range(values: Sequence[Array]) -> tuple[float, float]:
    joined = np.concatenate(values)
    joined = joined[np.isfinite(joined)]
    if not len(joined):
        return 0.0, 1.0
    low, high = float(joined.min()), float(joined.max())
    margin = 0.05 * (high - low) or 0.5
    return low - margin, high + margin


def _ticks(low: float, high: float) -> list[float]:
    step = 10.0 ** np.floor(np.log10((high - low) / 2))
    step *= next((factor for factor in (1, 2, 5) if (high - low) / (step * factor) <= 6), 10)
    return [round(k * step, 12) + 0.0 for k in np.arange(np.ceil(low / step), high / step)]


def _text(x: float, y: float, text: str, anchor: str, more: str = "") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" {more}>{escape(text)}</text>'
