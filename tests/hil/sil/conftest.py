"""Twins behind the servos, which take seconds to build."""

import pytest

from hil.emulator.physics import build_twin
from models.plant.plant import NOMINAL


@pytest.fixture(scope="session")
def twins(tmp_path_factory):
    """Twin FMU of the nominal plant by number of joints."""
    directory = tmp_path_factory.mktemp("twins")
    return {dof: build_twin(NOMINAL, dof, directory) for dof in (1, 2)}
