"""Kind of cases: run of the robot's loop in software, with a twin or a rig behind the servos."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final, Literal

import msgspec

from firmware_py.core.errors import InputError
from firmware_py.core.motion import KINDS as MOTIONS
from firmware_py.core.motion import STUDY_AMPLITUDE_RAD, STUDY_PERIOD_S
from hil.campaign.kinds.case_kind import CaseConfig, CaseContext, CaseKind
from hil.campaign.kinds.config_checks import check_effects_known, check_ranges
from hil.emulator.line_faults import LINE_FAULTS

if TYPE_CHECKING:
    from hil.sil import SilOptions


FRESH: Final = ("ok", "retried", "alert")
"""States of the bus in which a tick has fresh data (`firmware_py.bus.servo_bus.BusStatus`)."""


class SilConfig(CaseConfig, frozen=True, kw_only=True):
    """Configuration of a run in software."""

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
    seconds: float | None = None  # Duration; by default 10, or that of the plan's runs
    payload_kg: float | None = None  # At the tip; by default half of the link's largest
    payload_known: bool = False  # Whether the robot is configured with the payload
    motion: str = "sinusoid"  # Kind of motion, or a motion file
    amplitude_rad: float = STUDY_AMPLITUDE_RAD
    period_s: float = STUDY_PERIOD_S
    phase_2_rad: float = 0.0
    plan: str | None = None  # Tip plan to run instead of the motion
    runs: int = 1  # Number of runs of the plan
    open_loop: bool = False  # Whether the plan runs without feedback of the tip
    model: str | None = None  # Servo model; by default that of the link
    baud: int = 1_000_000
    latency_s: float = 1e-3  # Latency timer of the USB adapter
    # Rate of each kind of line fault
    faults: dict[str, float] = msgspec.field(default_factory=dict)
    seed: int = 0


class SilKind(CaseKind[SilConfig]):
    """Runs in software."""

    name: ClassVar[str] = "sil"
    config: ClassVar[type[SilConfig]] = SilConfig
    rooms: ClassVar[tuple[str, ...]] = ("firmware_py", "models", "fmu", "hil")
    figures: ClassVar = {
        "prediction_error.mean_euclidean_distance_m": "predicted tip off, mean",
        "prediction_error.max_m": "predicted tip off, largest",
        "prediction_error.interval_coverage": "covered by the interval, mean over the axes",
        "prediction_error.interval_coverage_least": "covered by the interval, worst axis",
        "path_errors.0.rms_m": "tip off its path, first run",
        "last_path_rms_m": "tip off its path, last run",
        "stale_ticks": "ticks without fresh data",
    }

    def files(self, config: SilConfig) -> dict[str, str]:
        found = {"bundle": config.bundle}
        found |= {n: p for n in ("fmu", "plan") if (p := getattr(config, n)) is not None}
        if config.rig is not None and Path(config.rig).is_file():
            found["rig"] = config.rig
        if config.motion not in MOTIONS:
            found["motion"] = config.motion
        return found

    def check(self, config: SilConfig) -> None:
        check_effects_known(config.effects)
        if unknown := sorted(config.faults.keys() - set(LINE_FAULTS)):
            raise InputError(
                f"faults.{unknown[0]}", "is no fault of the line", f"use {', '.join(LINE_FAULTS)}"
            )
        if not all(r >= 0 for r in config.faults.values()) or sum(config.faults.values()) > 1:
            raise InputError("faults", "are no fractions of the packets", "let them sum to ≤ 1")
        if config.rig is None and (config.effects or config.pressure_pa is not None):
            what = "effects" if config.effects else "pressure_pa"
            raise InputError(what, "is of the rig, not of a twin", 'add rig = "default"')
        if config.rig is not None and (config.fmu or config.line != "virtual"):
            raise InputError("rig", "stands in a twin's place, on the virtual line", "leave it out")
        if config.runs < 1 or (config.runs > 1 and config.plan is None):
            raise InputError("runs", f"is {config.runs}", "give 1 or more, with a plan")
        check_ranges(config, seconds=(0.017, 86_400.0), payload_kg=(0.0, 20.0), period_s=(0.1, 1e4))

    def in_real_time(self, config: SilConfig) -> bool:
        return config.line != "virtual"

    def prepare(self, config: SilConfig, directory: Path) -> dict[str, str]:
        """Build the twin, once for all cases of a bundle."""
        if config.fmu is not None or config.rig is not None:
            return {}
        return {"fmu": str(_twin_of(config.bundle, directory))}

    def run(self, config: SilConfig, context: CaseContext) -> dict[str, Any]:
        from hil.sil import run_sil  # loads CasADi and matplotlib
        from hil.sil.sil_results import timing_document

        options = _options(config, context.scratch)
        result = run_sil(options)
        document = timing_document(result, options)
        if document.interrupted:  # an incomplete run is no result
            raise InputError("run", document.interrupted, "run the campaign again")
        context.parts_s["run"] = result.wall_s
        stale = sum(n for status, n in document.run.bus_faults.items() if status not in FRESH)
        paths = [msgspec.to_builtins(error) for error in document.path_errors]
        found = {
            "ended": document.run.ended,
            "reason": document.run.reason,
            "ticks": document.ticks,
            "bus_faults": document.run.bus_faults,
            "stale_ticks": stale,
            "faults_injected": document.run.faults_injected,
            "prediction_error": msgspec.to_builtins(document.prediction_error),
            "path_errors": paths,
            "last_path_rms_m": paths[-1]["rms_m"] if paths else None,
            "moves": msgspec.to_builtins(document.moves),
            "records_sha256": document.environment.records_sha256,
        }
        if self.in_real_time(config):  # measured values, which differ from run to run
            found |= {
                "verdict": document.verdict.value, "misses": document.misses,
                "own_cost_p50_ns": document.own_cost.p50_ns,
                "own_cost_p99_ns": document.own_cost.p99_ns,
            }  # fmt: skip
        return found


KIND = SilKind()


@functools.lru_cache(maxsize=64)
def _twin_of(bundle: str, directory: Path) -> Path:
    from firmware_py.inference.bundle import read_manifest
    from hil.campaign.code_version import content_sha256
    from hil.emulator.physics import build_twin  # loads CasADi

    dof, plant = read_manifest(Path(bundle)).dof, Path(bundle) / "plant.json"
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


@functools.lru_cache(maxsize=8)
def _cached(load: Callable[[Path], Any], path: Path) -> Any:
    """Load a file once per worker, which has already checked the file's hash."""
    return load(path)


def _options(config: SilConfig, out: Path) -> SilOptions:
    from firmware_py.bus.servo_models import model_named
    from firmware_py.core.input_files import read_toml
    from firmware_py.core.motion import MotionConfig
    from firmware_py.goals.tip_plan import read_tip_plan
    from firmware_py.inference.bundle import ModelBundle
    from firmware_py.link.link_description import STUDY_LINK, describes_link, read_link
    from hil.emulator.physics import RigSource
    from hil.sil import SilOptions
    from models.plant.document import link_of_plant

    plant, link = Path(config.bundle) / "plant.json", STUDY_LINK
    if config.rig and Path(config.rig).is_file():
        if describes_link(read_toml(config.rig)):
            link = read_link(Path(config.rig))
    elif plant.is_file():
        link = _cached(link_of_plant, plant)
    plan = _cached(read_tip_plan, Path(config.plan)) if config.plan else None
    rest = 10.0 if plan is None else config.runs * plan.duration_s
    return SilOptions(
        bundle=_cached(ModelBundle.load, Path(config.bundle)),
        model=model_named(config.model or link.servo.model),
        out=out,
        log=False,
        fmu=Path(config.fmu) if config.fmu else None,
        rig=RigSource(config.effects, config.seed, config.rig, config.pressure_pa)
        if config.rig
        else None,
        line=config.line,
        seconds=rest if config.seconds is None else config.seconds,
        baud=config.baud,
        latency_s=config.latency_s,
        payload_kg=link.payload_kg / 2 if config.payload_kg is None else config.payload_kg,
        payload_known=config.payload_known,
        plan=plan,
        open_loop=config.open_loop,
        motion=MotionConfig(
            amplitude_rad=config.amplitude_rad,
            period_s=config.period_s,
            phase_2_rad=config.phase_2_rad,
        ).with_motion(config.motion),
        faults=config.faults,
        seed=config.seed,
    )
