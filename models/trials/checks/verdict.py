"""Verdict on a recording: findings and measurements, collected while it is imported."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from firmware_py.core.errors import InputError
from models.trials.checks.causes import ImportFinding
from models.trials.checks.pose import RestPose
from models.trials.checks.signals import Gap
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
