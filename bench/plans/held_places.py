"""Places at which the twin of a plant comes to rest by the goals of its map.

The goals of each place rise evenly from upright in 4 s and are held. What is left to the place is
taken 1, 10 and 60 s after the rise, over 0, 1 and 2 kg and five places of one joint.

    python -m bench.plans.held_places build/plant.json
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Final

from firmware_py.console import DONE
from firmware_py.errors import InputError
from firmware_py.goals.outside.goal_map import RestGoals
from firmware_py.signals import PERIOD_S
from models.plan.moves.rest_map import RAMP_S, map_rest
from models.plan.twin_sensitivity import TipTwin
from models.plant.plant import read_plant

PAYLOADS_KG: Final = (0.0, 1.0, 2.0)
PLACES_M: Final = (-0.65, -0.5, -0.3, 0.3, 0.5)
HOLDS_S: Final = (1.0, 10.0, 60.0)


def main(arguments: list[str]) -> int:
    """Measure and print."""
    plant = read_plant(Path(arguments[0]))
    twin = TipTwin(plant.step_model(1), 1, PERIOD_S)
    rest = RestGoals(map_rest(plant, 1, PERIOD_S, PAYLOADS_KG, 0.7))
    worst_mm = dict.fromkeys((f"after_{hold_s:g}_s_mm" for hold_s in HOLDS_S), 0.0)
    for payload_kg in PAYLOADS_KG:
        for place_m in PLACES_M:
            goals_rad = rest.goals_rad((place_m,), payload_kg)
            if goals_rad is None:
                raise InputError(
                    f"{place_m} m", f"is out of reach with {payload_kg} kg", "map less"
                )
            for hold_s, name in zip(HOLDS_S, worst_mm, strict=True):
                tip_m = twin.held_tip_m(goals_rad, payload_kg, RAMP_S, hold_s)
                worst_mm[name] = max(worst_mm[name], 1e3 * abs(float(tip_m[0]) - place_m))
    print(json.dumps(worst_mm))
    return DONE


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
