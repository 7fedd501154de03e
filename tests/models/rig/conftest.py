import math

import pytest

from firmware_py.core.motion import Motion
from models.rig.parameters import read_parameters
from models.rig.protocol import TrialCase, run_case
from tests.models.rig.rigs import QUICK


@pytest.fixture(scope="session")
def parameters():
    return read_parameters()


@pytest.fixture(scope="session")
def short(parameters):
    return parameters.changed(**QUICK)


@pytest.fixture(scope="session")
def short_case():
    def make(dof=2, payload_kg=1.0, trial=1, seed=0, **motion):
        motion = {"amplitude_rad": math.radians(8.0), "period_s": 0.8} | motion
        return TrialCase(Motion(dof=dof, **motion), payload_kg, trial, seed)

    return make


@pytest.fixture(scope="session")
def default_trial(short, short_case):
    return run_case(short, short_case())
