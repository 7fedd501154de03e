"""Kind of cases: run of the robot's loop in software, with a twin or a rig behind the servos."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import msgspec
from msgspec import Meta

from firmware_py.bus.servo_bus import BusStatus
from firmware_py.core.errors import InputError
from hil.campaign.kinds.case_kind import CaseKind, MotionOptions, Seed, check_effects, load_once
from hil.campaign.kinds.rig_kind import rig_file
from hil.emulator.line_faults import LINE_FAULTS

if TYPE_CHECKING:
    from hil.sil import SilOptions


class SilCaseOptions(MotionOptions, frozen=True, kw_only=True):
    """Options of a run in software."""

    bundle: str
    # Twin FMU behind the servos; by default it is built once from the bundle's plant
    fmu: str | None = None
    # Rig to simulate instead of a twin: a structure, a file that changes it, or a link
    rig: str | None = None
    # Strength of each effect added to the rig
    effects: dict[str, float] = msgspec.field(default_factory=dict)
    pressure_pa: float | None = None
    # "virtual" is a simulated clock; "socket" and "pty" are in real time
    line: Literal["virtual", "socket", "pty"] = "virtual"
    # Duration; by default 10, or that of the plan's runs
    seconds: Annotated[float, Meta(ge=0.017, le=86_400)] | None = None
    # At the tip; by default half of the link's largest
    payload_kg: Annotated[float, Meta(ge=0, le=20)] | None = None
    payload_known: bool = False  # Whether the robot is configured with the payload
    plan: str | None = None  # Tip plan to run instead of the motion
    runs: Annotated[int, Meta(ge=1)] = 1  # Number of runs of the plan
    open_loop: bool = False  # Whether the plan runs without feedback of the tip
    model: str | None = None  # Servo model; by default that of the link
    baud: int = 1_000_000
    latency_s: float = 1e-3  # Latency timer of the USB adapter
    # Rate of each kind of line fault
    faults: dict[str, float] = msgspec.field(default_factory=dict)
    seed: Seed = 0

    def __post_init__(self) -> None:
        check_effects(self.effects)
        if unknown := sorted(self.faults.keys() - set(LINE_FAULTS)):
            raise InputError(
                f"faults.{unknown[0]}", "is no fault of the line", f"use {', '.join(LINE_FAULTS)}"
            )
        if not all(r >= 0 for r in self.faults.values()) or sum(self.faults.values()) > 1:
            raise InputError("faults", "are no fractions of the packets", "let them sum to ≤ 1")
        if self.rig is None and (self.effects or self.pressure_pa is not None):
            what = "effects" if self.effects else "pressure_pa"
            raise InputError(what, "is of the rig, not of a twin", 'add rig = "default"')
        if self.rig is not None and (self.fmu or self.in_real_time):
            raise InputError("rig", "stands in a twin's place, on the virtual line", "leave it out")
        if self.runs > 1 and self.plan is None:
            raise InputError("runs", f"is {self.runs} without a plan", "name a plan")

    @property
    def in_real_time(self) -> bool:
        return self.line != "virtual"

    def files(self) -> dict[str, str]:
        named = {"bundle": self.bundle, "fmu": self.fmu, "plan": self.plan}
        return (
            super().files()
            | {name: path for name, path in named.items() if path is not None}
            | ({} if self.rig is None else rig_file(self.rig))
        )


def run_in_software(case: SilCaseOptions, scratch: Path) -> dict[str, Any]:
    from hil.sil import run_sil  # loads CasADi and matplotlib

    document = run_sil(_options(case, scratch)).timing
    if document.interrupted:  # an incomplete run is no result
        raise InputError("run", document.interrupted, "run the campaign again")
    faults = document.run.bus_faults
    stale = sum(n for name, n in faults.items() if not BusStatus[name.upper()].fresh)
    paths = [msgspec.to_builtins(error) for error in document.path_errors]
    result = {
        "ended": document.run.ended,
        "reason": document.run.reason,
        "ticks": document.ticks,
        "bus_faults": faults,
        "stale_ticks": stale,
        "faults_injected": document.run.faults_injected,
        "prediction_error": msgspec.to_builtins(document.prediction_error),
        "path_errors": paths,
        "last_path_rms_m": paths[-1]["rms_m"] if paths else None,
        "moves": msgspec.to_builtins(document.moves),
        "records_sha256": document.environment.records_sha256,
    }
    if case.in_real_time:  # measured values, which differ from run to run
        result |= {
            "verdict": document.verdict.value, "misses": document.misses,
            "own_cost_p50_ns": document.own_cost.p50_ns,
            "own_cost_p99_ns": document.own_cost.p99_ns,
        }  # fmt: skip
    return result


def with_twin(case: SilCaseOptions, directory: Path) -> SilCaseOptions:
    """Build the twin, once for all cases of a bundle."""
    if case.fmu is not None or case.rig is not None:
        return case
    return msgspec.structs.replace(case, fmu=str(_twin_of(case.bundle, directory)))


KIND = CaseKind(
    name="sil",
    options=SilCaseOptions,
    run=run_in_software,
    prepare=with_twin,
    sources=("firmware_py", "models", "fmu", "hil"),
    figures={
        "prediction_error.mean_euclidean_distance_m": "predicted tip off, mean",
        "prediction_error.max_m": "predicted tip off, largest",
        "prediction_error.interval_coverage": "covered by the interval, mean over the axes",
        "prediction_error.interval_coverage_least": "covered by the interval, worst axis",
        "path_errors.0.rms_m": "tip off its path, first run",
        "last_path_rms_m": "tip off its path, last run",
        "stale_ticks": "ticks without fresh data",
    },
)


def _twin_of(bundle: str, directory: Path) -> Path:
    from firmware_py.inference.bundle import read_manifest
    from hil.campaign.code_version import content_sha256
    from hil.emulator.physics import build_twin  # loads CasADi

    dof, plant = load_once(read_manifest, Path(bundle)).dof, Path(bundle) / "plant.json"
    if not plant.is_file():
        raise InputError(plant, "is missing", "copy the whole bundle, or name a twin with fmu")
    place = directory / f"twin_{content_sha256(plant)[:16]}"
    path = place / f"twin_{dof}dof.fmu"
    if not path.is_file():
        fresh = place / "fresh"
        fresh.mkdir(parents=True, exist_ok=True)
        build_twin(plant, dof, fresh).replace(path)
        fresh.rmdir()
    return path


def _options(case: SilCaseOptions, out: Path) -> SilOptions:
    from firmware_py.bus.servo_models import model_named
    from firmware_py.goals.tip_plan import read_tip_plan
    from firmware_py.inference.bundle import ModelBundle
    from hil.emulator.physics import RigSource
    from hil.sil import SilOptions
    from hil.sil.sil_options import DERIVED, SHORTEST_DEFAULT_S

    plan = load_once(read_tip_plan, Path(case.plan)) if case.plan else None
    rig = RigSource(case.effects, case.seed, case.rig, case.pressure_pa) if case.rig else None
    return SilOptions(
        bundle=load_once(ModelBundle.load, Path(case.bundle)),
        model=model_named(case.model) if case.model else DERIVED,
        out=out,
        log=False,
        fmu=Path(case.fmu) if case.fmu else None,
        rig=rig,
        line=case.line,
        # Without a plan a case is short: no case alone bounds a miss rate.
        seconds=case.seconds or (SHORTEST_DEFAULT_S if plan is None else DERIVED),
        baud=case.baud,
        latency_s=case.latency_s,
        payload_kg=DERIVED if case.payload_kg is None else case.payload_kg,
        payload_known=case.payload_known,
        plan=plan,
        runs=case.runs,
        open_loop=case.open_loop,
        motion=case.motion_config(),
        faults=case.faults,
        seed=case.seed,
    )
