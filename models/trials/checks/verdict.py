"""Verdict on an import: findings and measurements, collected during the import."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from firmware_py.display_units import DURATION
from firmware_py.errors import InputError
from models.trials.checks.finding import (
    CLOCK_DRIFT_S,
    CLOCK_ERROR_S,
    DRIFT_DEVIATIONS,
    GIVEN_CLOCK_S,
    ImportFinding,
)
from models.trials.checks.markers import Gap
from models.trials.checks.pose import RestPose
from models.trials.clock import Synchronisation
from models.trials.trial import Trial


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

    def check_clock(self) -> None:
        """Add findings if the clock's offset is uncertain, or drifts during the motion."""
        if self.clock is None:
            return
        low, high = CLOCK_ERROR_S
        if self.clock.error_s > low:
            self.findings.append(
                ImportFinding(
                    "refused" if self.clock.error_s > high else "warning", "clock",
                    f"the clock's offset is known to ±{DURATION.text(self.clock.error_s)} only",
                    "map m01 to m08, record more motion, or record a sync signal in both files",
                )
            )  # fmt: skip
        for drift in self.clock.drifts:
            if abs(drift.change_s) > max(CLOCK_DRIFT_S, DRIFT_DEVIATIONS * drift.deviation_s):
                self.findings.append(
                    ImportFinding(
                        "warning", "clock",
                        f"the two clocks drift apart by {DURATION.text(abs(drift.change_s))} in "
                        f"{drift.over_s:.1f} s",
                        "correct the frame rate of the motion capture, or record shorter takes",
                    )
                )  # fmt: skip
                break

    def check_given_offset(
        self, given_s: float, found: Synchronisation | None, apart_s: float
    ) -> None:
        """Add a finding if the user's offset differs from the estimate of signal or motion.

        There is no estimate if `found` is None. `apart_s` is added to both in the message, because
        clocks may count from an epoch.
        """
        if found is None:
            return
        differs_s = abs(given_s - found.offset_s)
        if differs_s > 3 * found.error_s + GIVEN_CLOCK_S:
            by = "sync signal" if found.by == "sync" else "motion"
            self.findings.append(
                ImportFinding(
                    "warning", "clock",
                    f"the offset given by hand, {given_s + apart_s:.4f} s, differs by "
                    f"{DURATION.text(differs_s)} from that of the {by}, "
                    f"{found.offset_s + apart_s:.4f} s ± {DURATION.text(found.error_s, 2)}",
                    "leave out --offset (offset_s in a table of takes), or correct it",
                )
            )  # fmt: skip

    def refuse(self, where: Path) -> None:
        """Refuse the import if a finding does."""
        reasons = self.refused
        if reasons:
            others = "".join(f"; also: {f.text}" for f in [*reasons[1:], *self.warnings][:2])
            raise InputError(where, reasons[0].text + others, reasons[0].remedy)

    def as_json(self) -> dict[str, Any]:
        """Verdict as JSON."""
        said: dict[str, Any] = {
            "verdict": "refused" if self.refused else "warned" if self.warnings else "passed",
            "findings": [f._asdict() for f in self.findings],
        }
        if self.pose is not None:
            said["rest_pose"] = {
                "offset_m": self.pose.offset_m.tolist(),
                "tilt_rad": self.pose.tilt_rad,
                "tip_aside_m": self.pose.tip_aside_m,
                "yaw_rad": self.pose.yaw_rad,
                "scale": self.pose.scale,
                "largest_misfit_m": float(self.pose.misfit_m.max()),
                "row_heights_m": [
                    None if np.isnan(v) else v for v in self.pose.row_heights_m.tolist()
                ],
            }
        if self.gaps:
            said["longest_gap_s"] = max(gap.length_s for gap in self.gaps)
        return said
