"""Wrong payloads that a robot is told, and how many of them the check after the run tells.

    make build/bundle_1dof
    python -m bench.robot.told_payload --bundle build/bundle_1dof

The rig stands behind the emulated servos, on the virtual line, with payloads of 0 to 2 kg and four
motions. The recorded samples of a run do not depend on the payload that the robot was told: each
run is judged with every one. Wrong: at least 0.5 kg off.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from bench.robot.virtual_rig_run import run_on_virtual_rig
from firmware_py.commands.payload_check import contradicted_payload
from firmware_py.console import DONE, Progress
from firmware_py.inference.bundle import ModelBundle
from firmware_py.motion import KINDS
from firmware_py.motion_config import MotionConfig

PAYLOADS_KG: Final = (0.0, 0.5, 1.0, 1.5, 2.0)
MOTIONS: Final = tuple(kind for kind in KINDS if kind != "decay")
"""Those that a robot repeats."""
AMPLITUDES_RAD: Final = {"large": math.radians(30.0), "small": math.radians(6.0)}
"""Of the motions: the study's, and a fifth of it."""
SEED: Final = 41
SECONDS: Final = 10.0


def counts_of(bundle: ModelBundle, amplitude_rad: float, progress: Progress) -> dict[str, int]:
    """Numbers of wrong and of right payloads, and of those that were told."""
    counts = dict.fromkeys(("wrong", "wrong_told", "right", "right_told"), 0)
    for number, kind in enumerate(MOTIONS):
        motion = MotionConfig(amplitude_rad=amplitude_rad).with_motion(kind)
        for payload_kg in PAYLOADS_KG:
            result = run_on_virtual_rig(
                bundle, payload_kg, SEED + number, seconds=SECONDS, motion=motion
            )
            for told_kg in PAYLOADS_KG:
                said = contradicted_payload(
                    bundle, told_kg, bundle.manifest.period_s, result.summary
                )
                key = "right" if told_kg == payload_kg else "wrong"
                counts[key] += 1
                counts[f"{key}_told"] += bool(said)
            progress.step(f"{kind}, {payload_kg:g} kg")
    return counts


def main(argv: Sequence[str] | None = None) -> int:
    """Run every motion and payload; print the counts as JSON."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.robot.told_payload", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("--bundle", type=Path, required=True, help="bundle of the robot")
    bundle = ModelBundle.load(parser.parse_args(argv).bundle)
    progress = Progress("told payload", len(AMPLITUDES_RAD) * len(MOTIONS) * len(PAYLOADS_KG))
    found = {
        name: counts_of(bundle, amplitude_rad, progress)
        for name, amplitude_rad in AMPLITUDES_RAD.items()
    }
    print(json.dumps(found, indent=1))
    return DONE


if __name__ == "__main__":
    raise SystemExit(main())
