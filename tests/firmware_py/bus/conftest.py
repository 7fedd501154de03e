"""Pairs of servos in memory, one pair of each control table."""

import pytest

from firmware_py.bus.servo_models import MODELS
from tests.firmware_py.bus.tampered import LEGACY, PRO_A, XM, make


@pytest.fixture(params=[LEGACY, PRO_A, XM], ids=lambda n: MODELS[n].table.name)
def pair(request):
    bus, transport, clock = make(request.param, request.param)
    bus.connect()
    return bus, transport, clock
