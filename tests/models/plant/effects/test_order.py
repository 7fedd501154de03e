"""The order of effects within a port: declared, complete, and independent of files and classes."""

import random

import pytest

from models.plant import plant as plant_module
from models.plant.effects import EFFECTS, ORDER, PORTS, Effect, in_order
from models.plant.plant import read_plant
from models.plant.step_model import names
from models.shared.catalogue import CATALOGUE, EVERY_EFFECT

FUNCTIONS = ("initial", "begin", "rate", "finish", "output")


@pytest.fixture
def shuffled_definitions():
    """Function seed -> None that defines the effects in another order; undone afterwards."""
    known = dict(EFFECTS)

    def shuffle(seed):
        rows = list(known.items())
        random.Random(seed).shuffle(rows)
        EFFECTS.clear()
        EFFECTS.update(rows)

    yield shuffle
    EFFECTS.clear()
    EFFECTS.update(known)


def composed(effects, dof, unit):
    model = read_plant().with_effects(*effects).step_model(dof, unit)
    functions = {name: getattr(model, name).serialize() for name in FUNCTIONS}
    return functions, names(model.parameters), names(model.states)


@pytest.mark.parametrize(("dof", "unit"), [(2, "twin"), (2, "driven"), (1, "observer")])
def test_the_order_of_definition_does_not_change_the_composed_model(
    shuffled_definitions, dof, unit
):
    before = composed(tuple(CATALOGUE), dof, unit)
    plant_module._compose.cache_clear()
    shuffled_definitions(1)
    backwards = tuple(name for name in reversed(tuple(EFFECTS)) if name in CATALOGUE)
    assert composed(backwards, dof, unit) == before


def test_the_candidates_of_a_plant_stand_in_the_declared_order(shuffled_definitions):
    before = read_plant().applicable()
    shuffled_definitions(3)
    assert read_plant().applicable() == before == [e for e in ORDER if e in CATALOGUE]


def test_every_effect_has_one_place():
    assert sorted(ORDER) == sorted(EFFECTS) == sorted(EVERY_EFFECT)
    assert {effect.port for effect in EFFECTS.values()} == set(PORTS)


@pytest.mark.parametrize(
    ("unit", "ports"), [("twin", PORTS), ("driven", [p for p in PORTS if p != "command"])]
)
def test_the_ports_are_served_in_the_declared_order(shuffled_definitions, unit, ports):
    shuffled_definitions(5)  # so that the probes are forgotten afterwards
    served = []

    def probe(at):
        class Probe(Effect):
            name, port = f"probe_{at}", at

            def apply(self, scope):
                served.append(self.port)

    for port in reversed(PORTS):
        probe(port)
    read_plant().with_effects(*(f"probe_{port}" for port in PORTS)).step_model(1, unit)
    assert served == list(ports)


def test_effects_of_ones_own_act_last_by_name(shuffled_definitions):
    shuffled_definitions(4)  # so that the two below are forgotten afterwards

    class Zeta(Effect):
        name, port = "zeta", "sensor"

    class Alpha(Effect):
        name, port = "alpha", "sensor"

    assert in_order(("zeta", "sync_offset", "alpha", "encoder_offset")) == [
        "encoder_offset", "sync_offset", "alpha", "zeta",
    ]  # fmt: skip
