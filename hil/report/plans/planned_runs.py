"""Runs of plans in a directory: path error by dof, payload and what the robot knows of it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from firmware_py.core.signals import tip_names
from firmware_py.goals.tip_plan import TipPlan, read_tip_plan
from firmware_py.log.recording import read_recording
from firmware_py.system.targets import PATH_RMS_TO_RIGID
from hil.sil.sil_run import LOG_NAME
from hil.sil.timing_document import read_timing
from models.trials.files import read_trial

Array = NDArray[np.float64]
Knowledge = Literal["rigid", "known", "unknown", "misled"]
"""Rigid kinematics; or the plan, with the payload known, estimated, or configured too small."""
KNOWLEDGE: Final[tuple[Knowledge, ...]] = ("rigid", "known", "unknown")
"""Runs that are compared. The run "misled" shows what happens when the estimate is not trusted."""
_ORDER: Final = (*KNOWLEDGE, "misled")
_NAME: Final = re.compile(rf"([12])dof_({'|'.join(_ORDER)})_([\d.]+)")


@dataclass(frozen=True)
class PlannedRun:
    """Last run of a plan in a directory of `dropstitch sil`."""

    dof: int
    knowledge: Knowledge
    payload_kg: float  # Payload of the rig; for "misled", the payload in the configuration
    plan: TipPlan
    tip_m: Array  # (n, dof), true tip at each row of the plan, in its last run
    rms_m: float  # RMS path error of that run, from timing.json
    max_m: float  # Largest path error of that run, from timing.json
    goals_rad: Array  # (n, dof), goals that were sent
    # (n,), trust in the estimated tip (`firmware_py.safety.estimate_trust.TrustState`)
    trust: NDArray[np.int64]
    unknown_kg: float = 0.0  # Further mass at the tip that the configuration lacks

    @property
    def away_m(self) -> Array:
        """Distance from the path, shape (n,)."""
        return np.asarray(np.linalg.norm(self.tip_m - self.plan.desired_tip_m(), axis=1))


def read_planned_runs(directory: Path) -> list[PlannedRun]:
    """Read the runs of `make tip-demo`, sorted by dof, payload and knowledge.

    The directory also holds the plans `inverse_Ndof.json` and `rigid_Ndof.json`.
    """
    found = []
    for folder in sorted(directory.glob("*")):
        match = _NAME.fullmatch(folder.name)
        if match and (folder / "timing.json").exists():
            found.append(_read(directory, folder, *match.groups()))
    if not found:
        raise InputError(directory, "holds no run of a plan", "run 'make tip-demo'")
    return sorted(found, key=lambda r: (r.dof, r.payload_kg, _ORDER.index(r.knowledge)))


def _read(directory: Path, folder: Path, dof: str, kind: str, payload: str) -> PlannedRun:
    knowledge = next(k for k in _ORDER if k == kind)
    method = "rigid" if knowledge == "rigid" else "inverse"
    plan = read_tip_plan(directory / f"{method}_{dof}dof.json")
    timing = read_timing(folder / "timing.json")
    trial = read_trial(folder / "trial" / "sil.csv")
    if not timing.path_errors:
        raise InputError(
            folder, f"holds no whole run of the plan ({timing.reason})", "run it again"
        )
    runs = len(timing.path_errors)
    log = read_recording(folder / LOG_NAME).columns
    start = -int(log["tick"][0]) + (runs - 1) * plan.rows
    rows = slice(start, start + plan.rows)
    goals = np.column_stack([log[f"goal_{j}_rad"] for j in range(1, plan.dof + 1)])
    tip = np.column_stack([trial.columns[name] for name in tip_names()[: plan.dof]])
    last = timing.path_errors[-1]
    return PlannedRun(
        int(dof), knowledge, float(payload), plan, tip[rows], last.rms_m, last.max_m, goals[rows],
        log["trust"][rows].astype(np.int64),
        timing.environment.hidden.get("unmodelled_payload", 0.0),
    )  # fmt: skip


def plan_figures(runs: list[PlannedRun]) -> dict[str, Any]:
    """Return RMS path errors by dof and payload, with their ratios to those of rigid kinematics.

    `K_ratio` is the largest ratio, `K_times_Ndof` the smallest improvement (the inverse ratio).
    """
    cases: list[dict[str, Any]] = []
    runs = [r for r in runs if r.knowledge in KNOWLEDGE]
    for dof, payload_kg in sorted({(r.dof, r.payload_kg) for r in runs}):
        own = {r.knowledge: r for r in runs if (r.dof, r.payload_kg) == (dof, payload_kg)}
        case: dict[str, Any] = {"dof": dof, "payload_kg": payload_kg}
        case |= {f"{k}_rms_m": r.rms_m for k, r in own.items()}
        if "rigid" in own:
            case |= {
                f"{k}_ratio": own[k].rms_m / own["rigid"].rms_m
                for k in PATH_RMS_TO_RIGID
                if k in own
            }
        cases.append(case)
    worst = {
        f"{k}_ratio": max((c[f"{k}_ratio"] for c in cases if f"{k}_ratio" in c), default=None)
        for k in PATH_RMS_TO_RIGID
    }
    times = {
        f"{k}_times_{dof}dof": min(
            (1 / c[f"{k}_ratio"] for c in cases if c["dof"] == dof and f"{k}_ratio" in c),
            default=None,
        )
        for k in PATH_RMS_TO_RIGID
        for dof in sorted({r.dof for r in runs})
    }
    return {"cases": cases} | worst | times
