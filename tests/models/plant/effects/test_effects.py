"""The catalogue as a whole: complete, absent at zero, differentiable, stable, refused in place."""

import numpy as np
import pytest

from firmware_py.errors import InputError
from models.plant.effects import EFFECTS
from models.plant.plant import read_plant, scope_of
from models.plant.simulation.runner import CompiledModel
from models.plant.step_model import names
from models.shared.catalogue import EVERY_EFFECT

ALL = tuple(read_plant().applicable())
"""Effects of the link; those of other loads have tests of their own."""
UNITS = ("twin", "driven", "observer")


def unit_of_strength(name, drive="cascade", load="link"):
    plant_scope = scope_of(drive, load, 1)
    return EFFECTS[name]().parameters(plant_scope)[0].unit


def test_every_name_of_the_catalogue_is_an_effect_with_its_port_and_unit():
    assert set(EFFECTS) == set(EVERY_EFFECT)
    for name, row in EVERY_EFFECT.items():
        assert EFFECTS[name].port == row.port
        assert unit_of_strength(name) == row.unit, name


def test_every_effect_is_bounded_and_absent_by_default():
    for name, effect in EFFECTS.items():
        parameters = effect().parameters(scope_of("cascade", "link", 2))
        strengths = effect.strengths(scope_of("cascade", "link", 2))
        assert parameters[0].name == strengths[0]
        assert len({q.name for q in parameters}) == len(parameters)
        for q in parameters:
            assert np.isfinite([q.low, q.high]).all(), (name, q)
            assert q.low <= q.value <= q.high and q.low < q.high
            if q.name in strengths:
                assert q.value == 0, (name, q.name)
            elif q.value == 0 and q.prior_deviation is None and "_cosine_" not in q.name:
                assert q.role == "fixed", (name, q.name)


@pytest.mark.parametrize(
    "effect, phase",
    [
        ("dead_time", "dead_time_phase_1"),
        ("sensor_lag", "sensor_lag_jump_1"),
        ("stribeck_friction", "stribeck_distance_1_rad"),
    ],
)
def test_a_drive_without_a_staircase_or_with_bristles_has_no_parameter_for_it(effect, phase):
    held, plain = (
        {q.name for q in EFFECTS[effect]().parameters(scope_of(drive, load, 1))}
        for drive, load in (("cascade", "link"), ("duty", "pendulum"))
    )
    assert held - plain == {phase}


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("dof", [1, 2])
def test_all_effects_at_zero_change_no_bit(bench, dof, unit):
    without = bench.run((), dof=dof, kind=unit, count=120)
    holding = bench.run(ALL, dof=dof, kind=unit, count=120)
    for output, values in without.items():
        assert np.array_equal(values, holding[output]), output


def test_all_effects_at_zero_change_no_bit_of_the_nominal_plant(bench):
    """Beside the effects that it holds at their own strength, in both planes."""
    nominal = read_plant()
    runs = []
    for plant in (nominal, nominal.with_effects(*ALL)):
        model = plant.step_model(2)
        runs.append(model.simulate(bench.inputs(model, 30), bench.step_s))
    assert np.array_equal(*runs)


def test_the_order_in_a_document_does_not_matter(bench):
    changes = {"prebend_1_rad": 0.05, "directional_stiffness_1": 0.3, "creep_share_1": 0.2}
    trio = ("prebend", "directional_stiffness", "creep")
    forward, backward = bench.run(trio, changes), bench.run(trio[::-1], changes)
    assert all(np.array_equal(forward[k], backward[k]) for k in forward)


# --- sensitivities --------------------------------------------------------------------------------

UNEXCITED = {"current_saturation_1_a"}  # the limit is far


def test_sensitivities_by_every_strength_at_zero(bench):
    """Exact, also where zero is a bound; zero only where the run does not excite the effect."""
    plant = bench.plant(*ALL)
    model = plant.step_model(1)
    strengths = [s for name in ALL for s in plant.strengths(name, 1)]
    u = bench.inputs(model, 100)
    _, slopes = CompiledModel(model, strengths).derivatives(u, bench.step_s)
    assert np.isfinite(slopes).all()
    plain = bench.compiled(ALL)
    for k, name in enumerate(strengths):
        step = 1e-5 * min(plant.parameters[name].high, 1.0)
        ends = [
            plain.simulate(u, bench.step_s, model.parameter_values({name: sign * step}))
            for sign in (1, -1)
        ]
        difference = (ends[0] - ends[1]) / (2 * step)
        scale = np.abs(slopes[:, :, k]).max()
        assert (scale > 0) == (name not in UNEXCITED), name
        assert np.abs(slopes[:, :, k] - difference).max() <= 1e-3 * scale + 1e-6, name


# --- stability ------------------------------------------------------------------------------------


@pytest.mark.parametrize("dof", [1, 2])
def test_all_effects_at_once_stay_finite_within_half_their_bounds(bench, dof):
    """Beyond that, effects that all weaken drive and link together let the robot fall over."""
    plant = bench.plant(*ALL)
    strengths = {s for name in ALL for s in plant.strengths(name, dof)}
    model = bench.compiled(ALL, dof).model
    drawn = [q for q in plant.parameters.values() if q.role == "effect" or q.name in strengths]
    drawn = [q for q in drawn if q.name in names(model.parameters)]
    rng = np.random.default_rng(2026)
    finite = 0
    for _ in range(40):
        changes = {
            q.name: rng.uniform(q.low, q.high) * (0.5 if q.name in strengths else 1.0)
            for q in drawn
        }
        finite += all(
            np.isfinite(v).all() for v in bench.run(ALL, changes, dof=dof, count=400).values()
        )
    assert finite >= 39


@pytest.mark.parametrize("name", ALL)
def test_one_effect_stays_finite_at_its_bounds(bench, name):
    plant = bench.plant(*ALL)
    for dof in (1, 2):
        for side in ("low", "high"):
            changes = {s: getattr(plant.parameters[s], side) for s in plant.strengths(name, dof)}
            outputs = bench.run(ALL, changes, dof=dof)
            assert all(np.isfinite(v).all() for v in outputs.values()), (dof, side)
            assert np.abs(outputs["tip_x_m"]).max() < 1.2


# --- documents ------------------------------------------------------------------------------------


OWN = {
    "link": {},
    "mass": {"mass_kg": 95.0, "force_constant_1_n_v": 35.0},
    "pendulum": {"mass_kg": 0.5, "arm_length_m": 0.1, "duty_gain_1": 1.0, "current_limit_1_a": 3.0},
}
"""Constants of the machine, by load."""


def document(tmp_path, drive, load, effect):
    path = tmp_path / "plant.toml"
    path.write_text(
        f'schema = 1\nname = "p"\ndrive = {{ kind = "{drive}" }}\nload = {{ kind = "{load}" }}\n'
        f'effects = [{{ name = "{effect}" }}]\n[parameters]\n'
        + "".join(f"{name} = {value}\n" for name, value in OWN[load].items())
    )
    return path


def test_an_unknown_effect_is_refused_with_the_list(tmp_path):
    with pytest.raises(InputError, match=r"'fricton' is no effect.*coulomb_friction.*sync_offset"):
        read_plant(document(tmp_path, "cascade", "link", "fricton"))


@pytest.mark.parametrize(
    ("drive", "load", "effect", "missing"),
    [
        ("force", "mass", "prebend", "bend"),
        ("duty", "pendulum", "creep", "bend"),
        ("duty", "pendulum", "sync_offset", "tip"),
        ("force", "mass", "backlash", "gear load"),
        ("force", "mass", "current_bias", "current"),
        ("force", "mass", "current_saturation", "current limit"),
    ],
)
def test_an_effect_that_makes_no_sense_is_refused(tmp_path, drive, load, effect, missing):
    with pytest.raises(InputError, match=f"{effect}' acts on a {missing}, which a {load}"):
        read_plant(document(tmp_path, drive, load, effect))


@pytest.mark.parametrize(("drive", "load"), [("duty", "pendulum"), ("force", "mass")])
def test_the_others_work_on_every_load(tmp_path, drive, load):
    plant = read_plant(document(tmp_path, drive, load, "coulomb_friction"))
    held = plant.applicable()
    assert {"coulomb_friction", "viscous_friction", "dead_time", "load_offset"} <= set(held)
    grown = plant.with_effects(*held)
    models = [p.step_model(1) for p in (plant, grown)]
    time_s = 0.01 * np.arange(40)
    constant = {"payload_kg": 1.0, "enabled_1": 1.0, "supply_1_v": 5.0}
    u = np.array([[constant.get(n, 0.0) for n in names(models[0].inputs)]] * len(time_s))
    u[:, 0] = 0.3 * np.sin(5 * time_s)
    without, absent = (m.simulate(u, 0.01) for m in models)
    assert np.array_equal(without, absent)
    for name in held:
        (strength,) = grown.strengths(name, 1)
        q = grown.parameters[strength]
        changed = models[1].simulate(u, 0.01, models[1].parameter_values({strength: 0.3 * q.high}))
        assert np.isfinite(changed).all() and not np.array_equal(changed, absent), name
    if load == "mass":
        assert grown.parameters["coulomb_friction_1_n"].unit == "N"
        assert grown.parameters["viscous_friction_1_n_s_m"].unit == "N.s/m"
