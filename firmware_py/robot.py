"""Put together what a configuration names: the bundle, the bus, the facts for the log."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

import msgspec

from firmware_py import __version__
from firmware_py.bus.dynamixel import DynamixelBus
from firmware_py.bus.transport import Transport, open_transport
from firmware_py.config import RobotConfig
from firmware_py.errors import InputError
from firmware_py.inference.bundle import MANIFEST, ModelBundle, sha256_of
from firmware_py.realtime.clock import Clock


def load_bundle(config: RobotConfig, path: Path) -> ModelBundle:
    """Load the bundle that a configuration names and check that the two fit together."""
    bundle = ModelBundle.load(path.parent / config.bundle)
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
    bundle.assume_payload(config.payload_kg)
    return bundle


@contextlib.contextmanager
def open_bus(config: RobotConfig, clock: Clock) -> Iterator[DynamixelBus]:
    """Open the bus that a configuration describes; torque off and closed at the end."""

    def opener() -> Transport:
        return open_transport(config.bus.port, config.bus.baud, clock)

    bus = DynamixelBus(
        opener(), config.setups(), clock, period_s=config.period_s,
        return_delay_s=config.bus.return_delay_s, name=config.bus.port, baud=config.bus.baud,
        reply_timeout_s=config.bus.reply_timeout_s, opener=opener,
    )  # fmt: skip
    try:
        yield bus
    finally:
        bus.close()


def log_metadata(config: RobotConfig, bundle: ModelBundle, started: datetime) -> dict[str, str]:
    """What a log says about the run that it is of."""
    return {
        "started_utc": started.isoformat(),
        "software": f"dropstitch {__version__}",
        "bundle": str(bundle.directory.resolve()),
        "manifest_sha256": sha256_of(bundle.directory / MANIFEST),
        "period_s": repr(config.period_s),
        "payload_kg": msgspec.json.encode(config.payload_kg).decode(),
        "rest_samples": str(round(config.motion.rest_s / config.period_s)),
        "config": msgspec.json.encode(config).decode(),
    }
