"""Page of the verdict on an import: findings, measurements, pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from firmware_py.display_units import ANGLE, ANGLE_ERROR, DURATION, LENGTH
from models.shared.kinematics import pointing_angles_rad
from models.shared.page_parts import Figure, LegendEntry, Panel, Paragraph, Section, Table
from models.shared.palette import MEASURED, SIMULATED
from models.trials.importers.synchronisation import Synchronisation
from models.trials.origin_notice import origin_notice
from models.trials.trial_origin import origins_of
from models.trials.verdict.finding import SHAPE_M
from models.trials.verdict.import_verdict import ImportVerdict
from models.trials.verdict.motion_findings import link_direction
from models.trials.verdict.rest_pose import RestPose
from models.trials.verdict.verdict_drawing import Curve, chart, side_view


def write_verdict(verdict: ImportVerdict, directory: Path) -> Path:
    """Write the page of a verdict."""
    from models.shared.html_page import render_page  # loads Jinja

    state = verdict.as_json()["verdict"]
    lead = Paragraph(
        f"The import was {state}." if state != "warned" else "Imported, with warnings."
    )
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
        labels = [n if d > SHAPE_M[1] else "" for n, d in zip(pose.names, apart, strict=True)]
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
    if clock is not None and clock.fit is not None:
        fit = clock.fit
        left = [Curve(fit.time_s, ANGLE_ERROR.shown(column), MEASURED) for column in fit.residual.T]
        title = "Left between the clocks, without bend"
        panels.append(Panel(title, title, chart(left, "time in s", ANGLE_ERROR.label("angle"))))
    return panels
