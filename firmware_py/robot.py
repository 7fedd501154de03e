"""Assembly of a robot from its configuration: bundle, bus, control loop, metadata of the log.

Examples
--------
A run in simulated time against a servo in memory, without models:

>>> from firmware_py.bus.loopback import LoopbackTransport
>>> from firmware_py.config import BusConfig, ServoConfig
>>> from firmware_py.system.clock import SimClock
>>> config = RobotConfig(
...     bundle="",
...     bus=BusConfig(port="memory"),
...     servos=(ServoConfig(id=1, model="XM430-W350"),),
... )
>>> clock, servos = SimClock(), {setup.id: setup.model for setup in config.setups()}
>>> with contextlib.closing(build_bus(config, LoopbackTransport(servos), clock)) as bus:
...     summary = build_loop(config, NoModels(), bus, clock).run()
>>> summary.ended.value, summary.released, summary.timing.misses
('finished', True, 0)
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Protocol

import msgspec

from firmware_py import __version__
from firmware_py.bus.dynamixel import DynamixelBus
from firmware_py.bus.servo_bus import ServoBus
from firmware_py.bus.servo_models import GAINS, ServoGains
from firmware_py.bus.transport import Transport, open_transport
from firmware_py.config import RobotConfig, check_config
from firmware_py.core.errors import InputError
from firmware_py.goals.goal_source import GoalSource, GoalTable
from firmware_py.goals.tip_feedback import Correction
from firmware_py.inference.bundle import ModelBundle
from firmware_py.inference.bundle_signature import refuse_older
from firmware_py.inference.estimator import DeformationEstimator, NoEstimator
from firmware_py.inference.predictor import NoPredictor, Predictor
from firmware_py.log.scene import SHAPE_KEY, shape_of_plant
from firmware_py.log.telemetry import Telemetry
from firmware_py.loop import ControlLoop
from firmware_py.safety.supervisor import SafetySupervisor
from firmware_py.system.clock import Clock
from firmware_py.system.kernel_counters import Counters
from firmware_py.system.service import Service


class LoopModels(Protocol):
    """Models that the loop evaluates in every tick, such as a `ModelBundle`."""

    @property
    def estimator(self) -> DeformationEstimator: ...

    @property
    def predictor(self) -> Predictor: ...


class NoModels:
    """Models of a loop that estimates and predicts nothing, for benchmarks and tests."""

    def __init__(self) -> None:
        self.estimator, self.predictor = NoEstimator(), NoPredictor()


def load_bundle(config: RobotConfig, path: Path) -> ModelBundle:
    """Load the bundle that a configuration names and check that the two fit together.

    `path`: file of the configuration; the path of the bundle is relative to it.
    """
    bundle = ModelBundle.load(path.parent / config.bundle, config.trust.keys, config.runtime)
    manifest = bundle.manifest
    if manifest.dof != config.dof:
        raise InputError(
            path, f"bundle is for {manifest.dof} joints, servos has {config.dof}",
            "name the bundle that was trained for these servos",
        )  # fmt: skip
    if manifest.estimator == "lagged" and not math.isclose(manifest.period_s, config.period_s):
        raise InputError(
            path, f"period_s is {config.period_s}, the lagged estimator was trained at "
            f"{manifest.period_s}", "use its period, or a bundle with the observer",
        )  # fmt: skip
    if bundle.signature:
        refuse_older(bundle.signature, bundle.directory, path.parent / config.trust.memory)
    bundle.assume_payload(config.payload_kg)
    return bundle


def with_bundle_gains(config: RobotConfig, bundle: ModelBundle, path: Path) -> RobotConfig:
    """Return a configuration whose missing servo gains are those of the bundle's plant.

    Gains that the configuration gives stay. A bundle without gains in its manifest changes nothing.
    """
    servos = list(config.servos)
    for j, identified in enumerate(bundle.manifest.servo_gains):
        declared = servos[j].gains or ServoGains()
        merged = {}
        for name in GAINS:
            configured, other = getattr(declared, name), getattr(identified, name)
            if None not in (configured, other) and configured != other:
                raise InputError(
                    path, f"servo {servos[j].id} has gains with {name} = {configured}, the "
                    f"bundle's plant was identified with {other}",
                    "set the servo to the bundle's, or identify with the servo's",
                )  # fmt: skip
            merged[name] = other if configured is None else configured
        servos[j] = msgspec.structs.replace(servos[j], gains=ServoGains(**merged))
    config = msgspec.structs.replace(config, servos=tuple(servos))
    check_config(config, path)
    return config


def build_bus(
    config: RobotConfig,
    transport: Transport,
    clock: Clock,
    opener: Callable[[], Transport] | None = None,
) -> DynamixelBus:
    """Return the bus that a configuration describes, over an open transport.

    `opener`: opens the transport again after a disconnect; without it, `reopen` returns False.
    """
    return DynamixelBus(
        transport, config.setups(), clock, period_s=config.period_s,
        return_delay_s=config.bus.return_delay_s, name=config.bus.port, baud=config.bus.baud,
        reply_timeout_s=config.bus.reply_timeout_s, opener=opener,
    )  # fmt: skip


@contextlib.contextmanager
def open_bus(config: RobotConfig, clock: Clock) -> Iterator[DynamixelBus]:
    """Yield the bus that a configuration describes, not yet connected.

    At the end its torque is switched off and its port is closed.
    """

    def opener() -> Transport:
        return open_transport(config.bus.port, config.bus.baud, clock)

    bus = build_bus(config, opener(), clock, opener)
    try:
        yield bus
    finally:
        bus.close()


def build_loop(
    config: RobotConfig,
    bundle: LoopModels,
    bus: ServoBus,
    clock: Clock,
    *,
    goals: GoalSource | None = None,
    correction: Correction | None = None,
    slots: int | None = None,
    telemetry: Telemetry | None = None,
    counters: Counters | None = None,
    service: Service | None = None,
    keep: int = 4096,
) -> ControlLoop:
    """Return the control loop that a configuration describes, ready to run.

    `goals`: goals of each slot; by default the configured motion, repeated if `slots` is given.
    `slots`: slots to run before the controlled stop; the goals repeat. None runs the goals once.
    """
    if goals is None:
        goals = GoalTable(config.goals_rad(repeated=slots is not None))
    return ControlLoop(
        bus, bundle.estimator, bundle.predictor,
        SafetySupervisor(config.limits_in_force, config.dof, config.period_s), goals, clock,
        correction=correction, slots=slots, period_s=config.period_s,
        reply_timeout_s=config.bus.reply_timeout_s, replug_s=config.bus.replug_s,
        telemetry=telemetry, counters=counters, service=service, keep=keep,
    )  # fmt: skip


def log_metadata(
    config: RobotConfig,
    bundle: ModelBundle,
    started: datetime,
    settings: Sequence[Mapping[str, int]] = (),
) -> dict[str, str]:
    shape = shape_of_plant(bundle.plant)
    drawn = {SHAPE_KEY: msgspec.json.encode(shape).decode()} if shape else {}
    return drawn | {
        "started_utc": started.isoformat(),
        "software": f"dropstitch {__version__}",
        "bundle": str(bundle.directory.resolve()),
        "manifest_sha256": bundle.manifest_sha256,
        "period_s": repr(config.period_s),
        "payload_kg": msgspec.json.encode(config.payload_kg).decode(),
        "rest_samples": str(round(config.motion.rest_s / config.period_s)),
        "config": msgspec.json.encode(config).decode(),
        "servo_settings": msgspec.json.encode(settings).decode(),
    }
