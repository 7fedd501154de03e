"""Prediction while a fraction of the servos' answers is lost or corrupt: writes figures as JSON.

    make build/bundle_1dof
    python -m bench.robot.lost_answers --bundle build/bundle_1dof

The rig stands behind the emulated servos, on the virtual line. A servo whose answer was lost is
read again, some milliseconds late. Every rate runs with every seed and payload; the robot is told
the payload. Of each rate: the share of ticks whose prediction is in range, the largest distance
from the true tip, and how many answers were read again.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from bench.robot.virtual_rig_run import run_on_virtual_rig
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.console import DONE, Progress
from firmware_py.inference.bundle import ModelBundle
from hil.sil.prediction_error import prediction_error

RATES: Final[Mapping[str, Mapping[str, float]]] = {
    "none": {},
    "lost_1_percent": {"lost": 0.01},
    "lost_5_percent": {"lost": 0.05},
    "corrupt_5_percent": {"corrupt": 0.05},
}
PAYLOADS_KG: Final = (0.5, 1.0, 2.0)
SEEDS: Final = (31, 32)
SECONDS: Final = 10.0


def figures_at_rate(
    bundle: ModelBundle, faults: Mapping[str, float], progress: Progress
) -> dict[str, float]:
    """Figures over all payloads and seeds at one rate."""
    ticks = in_range = read_again = 0
    largest_m = 0.0
    for payload_kg in PAYLOADS_KG:
        for seed in SEEDS:
            result = run_on_virtual_rig(
                bundle, payload_kg, seed, seconds=SECONDS, payload_known=True, faults=faults
            )
            error = prediction_error(result.records, result.outcome.truth)
            ticks += error.n
            in_range += round(error.n * (error.in_range_fraction or 0.0))
            largest_m = max(largest_m, error.max_m or 0.0)
            read_again += result.summary.bus_faults.get(BusStatus.RETRIED.name.lower(), 0)
            progress.step(f"{payload_kg:g} kg, seed {seed}")
    return {
        "ticks": ticks,
        "read_again": read_again,
        "in_range": in_range / ticks,
        "largest_error_m": largest_m,
    }


def main(argv: Sequence[str] | None = None) -> int:
    """Run every rate; print the figures as JSON."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.robot.lost_answers", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("--bundle", type=Path, required=True, help="bundle of the robot")
    bundle = ModelBundle.load(parser.parse_args(argv).bundle)
    progress = Progress("lost answers", len(RATES) * len(PAYLOADS_KG) * len(SEEDS))
    found = {name: figures_at_rate(bundle, faults, progress) for name, faults in RATES.items()}
    print(json.dumps(found, indent=1))
    return DONE


if __name__ == "__main__":
    raise SystemExit(main())
