"""Every effect that may be missing fits the load and the drive of each measured system."""

from pathlib import Path

import pytest

from models.gap.residuals.fit_parameters import candidate_effects, plant_with_every_effect
from models.plant import examples
from models.plant.plant import read_plant

SYSTEMS = [p for p in sorted(Path(examples.__path__[0]).glob("*.toml")) if ".map" not in p.suffixes]


@pytest.mark.parametrize("path", SYSTEMS, ids=lambda p: p.stem)
def test_a_plant_of_a_measured_system_holds_every_effect_of_its_catalogue(path):
    plant = read_plant(path)
    twin = plant_with_every_effect(plant).step_model(1, "twin")
    known = {v.name for v in twin.parameters}
    assert all(set(plant_with_every_effect(plant).strengths(e, 1)) <= known
               for e in candidate_effects(plant))  # fmt: skip
