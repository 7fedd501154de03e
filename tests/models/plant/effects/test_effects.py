"""The catalogue as a whole: complete, absent at zero, differentiable, stable, in a fixed order."""

import random
import re
from pathlib import Path

import numpy as np
import pytest

from dropstitch.__main__ import main as dropstitch
from firmware_py.core.errors import InputError
from firmware_py.link.link_description import LinkDescription, LinkServo
from models.plant import plant as plant_module
from models.plant.effects import EFFECTS, PORTS, Effect, in_order
from models.plant.effects_page import main as write_page
from models.plant.parameter import Parameter, parameter_of_link
from models.plant.plant import read_plant, scope_of
from models.plant.simulation.runner import CompiledModel
from models.plant.step_model import names
from models.shared.catalogue import CATALOGUE
from models.shared.link_scale import LinkScale

ALL = tuple(read_plant().applicable())
"""Effects of the link."""
ROOT = Path(__file__).parents[4]


@pytest.fixture
def registry():
    """Effects by name; what a test adds or reorders is undone afterwards."""
    known = dict(EFFECTS)
    yield EFFECTS
    EFFECTS.clear()
    EFFECTS.update(known)


def test_every_effect_is_bounded_and_absent_by_default():
    scope = scope_of("cascade", "link", 2)
    for name, effect in EFFECTS.items():
        parameters, strengths = effect().parameters(scope), effect.strengths(scope)
        assert parameters[0].name == strengths[0]
        assert len({q.name for q in parameters}) == len(parameters)
        for q in parameters:
            assert np.isfinite([q.low, q.high]).all(), (name, q)
            assert q.low <= q.value <= q.high and q.low < q.high
            if q.name in strengths:
                assert q.value == 0, (name, q.name)
            elif q.value == 0 and q.prior_deviation is None and "_cosine_" not in q.name:
                assert q.role == "fixed", (name, q.name)


@pytest.mark.slow
@pytest.mark.parametrize(("dof", "unit"), [(2, "driven"), (1, "observer")])
def test_all_effects_at_zero_change_no_bit(bench, dof, unit):
    """Beside the effects that the nominal plant has at their identified strength."""
    nominal = read_plant()
    runs = []
    for plant in (nominal, nominal.with_effects(*ALL)):
        model = plant.step_model(dof, unit)
        runs.append(CompiledModel(model).simulate(bench.inputs(model, 120), bench.step_s))
    assert np.array_equal(*runs)


def test_sensitivities_by_every_strength_at_zero(bench):
    """Exact, also where zero is a bound; zero only where the run does not excite the effect."""
    plant, plain = bench.plant, bench.compiled()
    model = plain.model
    strengths = [s for name in ALL for s in plant.strengths(name, 1)]
    u = bench.inputs(model, 100)
    _, slopes = CompiledModel(model, strengths).derivatives(u, bench.step_s)
    assert np.isfinite(slopes).all()
    for k, name in enumerate(strengths):
        step = 1e-5 * min(plant.parameters[name].high, 1.0)
        ends = [
            plain.simulate(u, bench.step_s, model.parameter_values({name: sign * step}))
            for sign in (1, -1)
        ]
        difference = (ends[0] - ends[1]) / (2 * step)
        scale = np.abs(slopes[:, :, k]).max()
        assert (scale > 0) == (name != "current_saturation_1_a"), name  # the limit is far
        assert np.abs(slopes[:, :, k] - difference).max() <= 1e-3 * scale + 1e-6, name


@pytest.mark.slow
@pytest.mark.parametrize("dof", [1, 2])
def test_one_effect_stays_finite_at_its_bounds(bench, dof):
    plant = bench.plant
    for name in ALL:
        for side in ("low", "high"):
            changes = {s: getattr(plant.parameters[s], side) for s in plant.strengths(name, dof)}
            outputs = bench.run(changes, dof=dof)
            assert all(np.isfinite(v).all() for v in outputs.values()), (name, side)
            assert np.abs(outputs["tip_x_m"]).max() < 1.2, (name, side)


MACHINES = {
    "mass": {"mass_kg": 95.0, "force_constant_1_n_v": 35.0},
    "pendulum": {"mass_kg": 0.5, "arm_length_m": 0.1, "duty_gain_1": 1.0, "current_limit_1_a": 3.0},
}  # fmt: skip


@pytest.mark.parametrize(
    ("drive", "load", "effect", "message"),
    [
        ("cascade", "link", "fricton", "'fricton' is no effect.*coulomb_friction.*sync_offset"),
        ("force", "mass", "prebend", "prebend' acts on a bend, which a mass"),
        ("duty", "pendulum", "sync_offset", "sync_offset' acts on a tip, which a pendulum"),
        ("force", "mass", "backlash", "backlash' acts on a gear load, which a mass"),
        ("duty", "pendulum", "directional_friction", "acts on a straight guide"),
    ],
)
def test_an_effect_that_makes_no_sense_is_refused(plant_with, drive, load, effect, message):
    with pytest.raises(InputError, match=message):
        plant_with(drive, load, MACHINES.get(load, {}), [effect])


@pytest.mark.parametrize(("drive", "load"), [("duty", "pendulum"), ("force", "mass")])
def test_the_applicable_effects_work_on_other_loads(plant_with, drive, load):
    plant = plant_with(drive, load, MACHINES[load], ["coulomb_friction"])
    effects = plant.applicable()
    assert {"coulomb_friction", "viscous_friction", "dead_time", "load_offset"} <= set(effects)
    grown = plant.with_effects(*effects)
    models = [p.step_model(1) for p in (plant, grown)]
    constant = {"payload_kg": 1.0, "enabled_1": 1.0, "supply_1_v": 5.0}
    u = np.array([[constant.get(n, 0.0) for n in names(models[0].inputs)]] * 40)
    u[:, 0] = 0.3 * np.sin(0.05 * np.arange(40))
    without, absent = (m.simulate(u, 0.01) for m in models)
    assert np.array_equal(without, absent)
    for name in effects:
        (strength,) = grown.strengths(name, 1)
        q = grown.parameters[strength]
        changed = models[1].simulate(u, 0.01, models[1].parameter_values({strength: 0.3 * q.high}))
        assert np.isfinite(changed).all() and not np.array_equal(changed, absent), name
    if load == "mass":
        assert grown.parameters["coulomb_friction_1_n"].unit == "N"
        assert grown.parameters["viscous_friction_1_n_s_m"].unit == "N.s/m"


def one_parameter(unit, suffix, high):
    """Effect of a single strength, registered as a file of the user would."""

    class Extra(Effect):
        name, port = "extra", "servo_torque"
        per_joint = (Parameter(f"extra_{{j}}_{suffix}", unit, 0.0, 0.0, high, role="effect"),)

    return Extra


@pytest.mark.parametrize(
    ("unit", "suffix", "linear", "factor"),
    [
        ("N.m.s2/rad2", "{torque}_s2_{angle}2", "N.s2/m2", 1000),
        ("N.m/rad", "{torque}_{angle}", "N/m", 100),
        ("rad/(N.m.s)", "{angle}_{torque}_s", "m/(N.s)", 0.01),
        ("kg.m2", "kg_m2", "kg", 100),
        ("m", "m", "m", 1),
    ],
)
def test_on_a_straight_guide_bounds_are_those_of_a_belt_on_a_pulley(
    registry, unit, suffix, linear, factor
):
    (q,) = one_parameter(unit, suffix, 20.0)().parameters(scope_of("force", "mass", 1))
    assert q.unit == linear and q.high == pytest.approx(20 * factor)


@pytest.mark.parametrize("unit", ["N.m2", "kg.m2/s", "Nm"])
def test_a_unit_that_a_straight_guide_cannot_convert_is_refused(registry, unit):
    effect = one_parameter(unit, "x", 20.0)()
    with pytest.raises(InputError, match=r"extra_1_x.*'?" + unit):
        effect.parameters(scope_of("force", "mass", 1))


@pytest.mark.parametrize(
    ("unit", "torques"), [("N.m.s2/rad2", 1), ("N.m", 1), ("rad/(N.m)", -1), ("rad", 0)]
)
def test_a_new_strength_is_scaled_to_the_servo_of_another_link(registry, unit, torques):
    (q,) = one_parameter(unit, "x", 20.0)().parameters(scope_of("cascade", "link", 1))
    scale = LinkScale(LinkDescription(servo=LinkServo(model="XM430-W350")))
    ratio = scale.servo_ratios["torque_limit_nm"]
    assert parameter_of_link(q, scale).high == pytest.approx(20 * ratio**torques)


# --- order and registration -----------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(("dof", "unit"), [(2, "twin"), (1, "observer")])
def test_the_order_of_definition_does_not_change_the_composed_model(registry, dof, unit):
    def composed(effects):
        model = read_plant().with_effects(*effects).step_model(dof, unit)
        functions = ("initial", "begin", "rate", "finish", "output")
        return (
            [getattr(model, name).serialize() for name in functions],
            names(model.parameters),
            names(model.states),
        )

    before = composed(CATALOGUE)
    plant_module._compose.cache_clear()
    rows = list(registry.items())
    random.Random(1).shuffle(rows)
    registry.clear()
    registry.update(rows)
    assert composed([name for name in reversed(registry) if name in CATALOGUE]) == before
    assert read_plant().applicable() == in_order(CATALOGUE)


@pytest.mark.parametrize(
    ("unit", "ports"), [("twin", PORTS), ("driven", [p for p in PORTS if p != "command"])]
)
def test_the_ports_are_applied_in_the_declared_order(registry, unit, ports):
    applied = []

    def probe(at):
        class Probe(Effect):
            name, port = f"probe_{at}", at
            shared = (Parameter(f"probe_{at}", "1", 0.0, 0.0, 1.0, role="effect"),)

            def apply(self, scope):
                applied.append(self.port)

    for port in reversed(PORTS):
        probe(port)
    read_plant().with_effects(*(f"probe_{port}" for port in PORTS)).step_model(1, unit)
    assert applied == list(ports)
    assert in_order(("probe_mass", "sync_offset", "probe_command", "encoder_offset")) == [
        "encoder_offset", "sync_offset", "probe_command", "probe_mass",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("fields", "missing"),
    [
        ({"port": "mass"}, "name"),
        ({"name": "extra"}, "port.*catalogue.*joint_torque"),
        ({"name": "extra", "port": "joint"}, "'joint'.*joint_torque"),
        ({"name": "extra", "port": "mass"}, "strength.*per_joint"),
    ],
)
def test_a_class_that_is_no_effect_is_refused_by_its_name(registry, fields, missing):
    with pytest.raises(InputError, match="Unfinished.*" + missing):
        type("Unfinished", (Effect,), fields)
    assert "extra" not in registry


def test_an_effect_of_a_file_is_listed(registry, capsys):
    one_parameter("N.m.s2/rad2", "x", 20.0)
    assert dropstitch(["list", "effects"]) == 0
    (line,) = [row for row in capsys.readouterr().out.splitlines() if row.startswith("extra ")]
    assert "N.m.s2/rad2" in line and "servo_torque" in line and "catalogue" in line


def test_the_example_of_the_guide_is_an_effect(registry, monkeypatch, tmp_path):
    monkeypatch.chdir(ROOT)
    guide, space = Path("docs/plant/add-an-effect.md").read_text(), {}
    for block in re.findall(r"```python\n(.*?)```", guide, re.S):
        exec(block, space)
    model = CompiledModel(space["model"], ["hose_spring_1_nm"])
    u = np.zeros((100, len(model.model.inputs)))
    u[:, 0] = 0.3 * np.sin(2 * 0.017 * np.arange(100))
    y, slope = model.derivatives(u, 0.017)
    assert np.array_equal(y, CompiledModel(read_plant().step_model(1)).simulate(u, 0.017))
    ends = [
        model.simulate(u, 0.017, model.model.parameter_values({"hose_spring_1_nm": c}))
        for c in (1e-5, -1e-5)
    ]
    assert slope[:, :, 0] == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-4, abs=1e-6)
    variables = {v.name: v for v in model.model.parameters}
    assert variables["hose_spring_1_nm"].unit == "N.m"
    assert variables["hose_spring_1_nm"].maximum == 5.0 and "hose_rest_2_rad" not in variables
    path = tmp_path / "plant.json"
    space["plant"].with_values({"hose_spring_1_nm": 0.8}).write(path)
    again = read_plant(path)
    assert "hose_spring" in again.effects and again.parameters["hose_spring_1_nm"].value == 0.8


def test_the_page_of_the_effects_is_that_of_the_catalogue(tmp_path):
    write_page([str(tmp_path / "effects.md")])
    page = ROOT / "docs" / "gap" / "effects.md"
    assert (tmp_path / "effects.md").read_text(encoding="utf-8") == page.read_text(encoding="utf-8")
