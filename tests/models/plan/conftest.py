"""The nominal plant's twin of one joint, and a short path planned for two payloads."""

import pytest

from firmware_py.core.signals import PERIOD_S
from firmware_py.safety.limits import Limits
from models.plan.paths import PathOptions, built_in_path
from models.plan.plan import PlanRequest, plan_path
from models.plan.tip_twin import TipTwin
from models.plant.plant import read_plant

LIMITS = Limits(rate_rad_s=1.0)


@pytest.fixture(scope="session")
def plant():
    return read_plant()


@pytest.fixture(scope="session")
def twin(plant):
    return TipTwin(plant, 1, PERIOD_S)


@pytest.fixture(scope="session")
def planned(plant):
    path = built_in_path("line", 1, PERIOD_S, PathOptions(size_m=0.2, seconds=2.0))
    return plan_path(path, PlanRequest(plant, 1, PERIOD_S, LIMITS, (0.0, 1.0)))
