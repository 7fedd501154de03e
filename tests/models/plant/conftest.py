"""Plants with effects, run compiled."""

import functools
from dataclasses import replace

import numpy as np
import pytest

from models.plant.plant import read_plant
from models.plant.simulate import CompiledModel
from models.plant.step import names

STEP_S = 0.017


class Bench:
    """The nominal link, without any effect but those asked for."""

    step_s = STEP_S

    def plant(self, *effects):
        nominal = read_plant()
        own = {q for q in nominal.parameters if nominal.parameters[q].role != "effect"}
        kept = {name: nominal.parameters[name] for name in own}
        return replace(nominal, effects=(), parameters=kept).with_effects(*effects)

    @functools.cache  # noqa: B019 (one bench per session)
    def compiled(self, effects, dof=1, unit="twin"):
        return CompiledModel(self.plant(*effects).step_model(dof, unit))

    def inputs(self, model, count, goal=None, payload_kg=1.0):
        """Inputs by name; angles and currents of a measured unit are made up."""
        time_s = STEP_S * np.arange(count)
        goal = 0.5 * np.sin(1.44 * time_s) + 0.1 * np.sin(7 * time_s) if goal is None else goal
        known = {"payload_kg": np.full(count, payload_kg)}
        for j, share in ((1, 1.0), (2, 0.7)):
            known |= {f"{what}_{j}_rad": share * goal for what in ("goal", "angle")}
            known[f"current_{j}_a"] = 3.0 * share * goal
        return np.column_stack([known[name] for name in names(model.inputs)])

    def run(self, effects, changes=None, *, dof=1, unit="twin", count=300, **conditions):
        """Outputs by name."""
        compiled = self.compiled(tuple(effects), dof, unit)
        u = self.inputs(compiled.model, count, **conditions)
        p = compiled.model.parameter_values(changes or {})
        y = compiled.simulate(u, STEP_S, p)
        return dict(zip(names(compiled.model.outputs), y.T, strict=True))


@pytest.fixture(scope="session")
def bench():
    return Bench()
