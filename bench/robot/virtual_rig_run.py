"""Run of the robot's loop on the virtual line, with the rig behind the emulated servos."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from firmware_py.bus.servo_models import model_named
from firmware_py.inference.bundle import ModelBundle
from firmware_py.motion_config import MotionConfig
from hil.emulator.physics import RigSource
from hil.sil import SilOptions, run_sil
from hil.sil.sil_loop import SilResult

SERVO: Final = "H54-200-S500-R"


def run_on_virtual_rig(
    bundle: ModelBundle,
    payload_kg: float,
    seed: int,
    *,
    seconds: float,
    motion: MotionConfig | None = None,
    payload_known: bool = False,
    faults: Mapping[str, float] | None = None,
    rig: str = "default",
) -> SilResult:
    """Run the loop; nothing is written."""
    with TemporaryDirectory(prefix="dropstitch-") as scratch:
        options = SilOptions(
            bundle=bundle, model=model_named(SERVO), out=Path(scratch),
            rig=RigSource({}, seed, rig), line="virtual", seconds=seconds,
            motion=motion or MotionConfig(), payload_kg=payload_kg,
            payload_known=payload_known, faults=faults or {}, seed=seed, log=False,
        )  # fmt: skip
        return run_sil(options)
