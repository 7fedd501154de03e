"""Map of the goals at rest: a held approach ends where the map says, between its places as well."""

import numpy as np
import pytest

from firmware_py.goals.outside.goal_map import RestGoals
from firmware_py.signals import PERIOD_S
from models.plan.moves import map_rest


def approached(twin, goals, payload_kg):
    """Tip of the twin after a ramp of 4 s from upright and a hold of 10 s."""
    ramp = np.minimum(np.arange(round(14.0 / PERIOD_S) + 1) * PERIOD_S / 4.0, 1.0)
    return twin.tip_m(twin.run(np.outer(ramp, goals), payload_kg))[-1]


def test_the_tip_of_the_twin_comes_to_rest_where_the_map_says(plant, twin):
    found = map_rest(plant, 1, PERIOD_S, (0.0, 2.0), 0.6)
    rest = RestGoals(found)
    for payload_kg in (0.0, 2.0):
        for place in (-0.55, 0.0, 0.123, 0.5):
            goals = rest.goals_rad((place,), payload_kg)
            assert approached(twin, goals, payload_kg) == pytest.approx(place, abs=1e-3)
    assert rest.goals_rad((0.61,), 1.0) is None
    light, heavy = (rest.mode(kg)[0][0] for kg in (0.0, 2.0))
    assert 0.1 < light < heavy < 0.5
