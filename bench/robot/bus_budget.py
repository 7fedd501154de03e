"""Transmission time of a tick by bus plan: two PH54 at 1 Mbaud and a return delay of 500 µs.

    python -m bench.robot.bus_budget

Prints the times as JSON; `dropstitch doctor --bus` shows them for a configured robot.
"""

from __future__ import annotations

import json
from typing import Final

from firmware_py.bus.bus_plan import FACTORY_RETURN_DELAY_S, plans
from firmware_py.bus.servo_models import model_named

BAUD: Final = 1_000_000
SERVO, JOINTS = "PH54-200-S500-R", 2


def main() -> None:
    """Print read, write and sum of every plan, in ms."""
    candidates = plans(model_named(SERVO).table, JOINTS, BAUD, FACTORY_RETURN_DELAY_S)
    rows = {
        plan.name: {
            "block_bytes": plan.block.size, "read_ms": 1e3 * plan.read_s,
            "write_ms": 1e3 * plan.write_s, "total_ms": 1e3 * plan.total_s,
        }
        for plan in candidates
    }  # fmt: skip
    print(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
