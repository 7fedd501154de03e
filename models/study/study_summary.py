"""Summary of a study for the console: figures of each test, and warnings."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from firmware_py.display_units import FRACTION, LENGTH

if TYPE_CHECKING:
    from models.study.study_document import StudyDocument


def study_summary(out: Path, document: StudyDocument) -> str:
    degree = str(document.chosen_degree)
    lines = [f"{out}: degree {degree} by cross-validation on trial 1"]
    for name, table in document.mean_euclidean_distance_m.items():
        pooled, kept = table["pooled"], document.deployed[name]
        r2 = document.estimators[name]["observer"].r2_di
        lines.append(
            f"  {name}: mean Euclidean distance "
            f"{LENGTH.number(pooled['estimated_di'][degree], 2)} mm with "
            f"estimated DI ({LENGTH.number(pooled['with_di'][degree], 2)} with true DI, "
            f"{LENGTH.number(pooled['without_di'][degree], 2)} without), R² of DI {r2:.3f}; "
            f"with inputs kept within the training range "
            f"{LENGTH.number(kept.mean_euclidean_distance_m, 2)} mm: "
            f"{FRACTION.text(kept.in_range_fraction)} of the rows are within it, the interval "
            f"covers {FRACTION.text(kept.interval_coverage_mean)}"
        )
    if not any(name.startswith("trial_") for name in document.tests):
        lines.append("  no trial 2 to test on: simulate with --trials 2")
    if not any(name.startswith("unseen") for name in document.tests):
        lines.append(
            "  no unseen motion: dropstitch simulate --amplitude-deg 20 --trials 1 --out "
            "build/unseen_20deg (with --rig link.toml for your link), then --unseen that directory"
        )
    return "\n".join(lines)
