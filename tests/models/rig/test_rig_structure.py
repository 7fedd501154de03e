"""Rigs that differ in structure: their files, and what each of them must do."""

import json

import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.console import BAD_INPUT, DONE
from firmware_py.errors import InputError
from models.rig.forms import relaxation_spectrum
from models.rig.hinged import BendLaw
from models.rig.parameters import (
    DEFAULT_STRUCTURE,
    RIG_TOML,
    named_structures,
    read_parameters,
    read_rig,
)
from models.rig.protocol import build_rig, run_case
from models.shared.catalogue import CATALOGUE
from models.shared.kinematics import rigid_tip_m
from tests.models.rig.strengths import STRENGTH

NAMED = named_structures()
HINGED = [name for name, named in NAMED.items() if named.structure.engine == "mujoco"]
FORMS = [f for f in DEFAULT_STRUCTURE.__struct_fields__ if f not in ("engine", "hinges")]

OF_SENSORS = {
    "current_bias", "current_scale", "marker_frame_tilt", "marker_scale", "pressure_leak",
    "sync_offset",
}  # fmt: skip
"""Effects that no single engine has: of the sensors, and of a whole trial."""


def course(rig, seconds, goal_rad):
    """Tip, encoder and sampled current every control period, goal after goal."""
    log = []
    for _ in range(round(seconds / 0.017)):
        rig.send(goal_rad)
        for _ in range(round(0.017 / rig.step_s)):
            rig.step()
        servos = [(s.encoder_rad, s.sampled_current_a) for s in rig.servos]
        log.append([*rig.markers_m[12:].mean(axis=0), *np.ravel(servos)])
    return np.array(log)


def test_structures_cover_every_form_in_both_purposes():
    for form in FORMS:
        values = {getattr(named.structure, form) for named in NAMED.values()}
        assert len(values) > 1, form
    assert {named.purpose for named in NAMED.values()} == {"tuning", "test"}
    assert NAMED["default"].structure == DEFAULT_STRUCTURE


@pytest.mark.parametrize("name", NAMED)
def test_every_effect_has_the_same_place_in_every_structure(name):
    assert read_rig(name).effects() == read_parameters().effects()
    assert set(read_rig(name).effects()) == set(CATALOGUE)


def test_the_default_structure_is_the_rig_of_the_parameters_alone(short, short_case, default_trial):
    rig = read_rig("default").changed(**{n: short[n] for n in short})
    assert run_case(rig, short_case()).sha256() == default_trial.sha256()


def test_the_hash_tells_structures_apart():
    assert len({read_rig(name).sha256() for name in NAMED}) == len(NAMED)


@pytest.mark.parametrize("name", HINGED)
def test_a_rig_holds_still_at_zero(name):
    """After the link has settled from its prebend: less than the noise of the markers, 0.15 mm."""
    log = course(build_rig(read_rig(name), 1, 1.0), 9.0, np.zeros(1))
    last = log[-36:]  # the period of its first mode
    assert np.ptp(last[:, :3], axis=0).max() < 1.5e-4
    assert np.abs(last[:, 3]).max() < 2e-3
    assert 0.0 < last[-1, 0] < 0.02 and abs(last[-1, 1]) < 1e-6


@pytest.mark.parametrize("name", HINGED)
def test_a_rig_follows_its_goal_and_bends_outwards(name):
    goal = np.array([0.3, -0.2])
    log = course(build_rig(read_rig(name), 2, 1.0), 4.0, goal)[-36:].mean(axis=0)  # of a swing
    angle_rad, tip_m = log[[3, 5]], log[:3]
    np.testing.assert_allclose(angle_rad, goal, atol=0.01)
    bend_m = tip_m - rigid_tip_m(angle_rad[None], 0.06, 0.95)[0]
    assert 0.005 < bend_m[0] < 0.1 and -0.1 < bend_m[1] < -0.005


@pytest.mark.parametrize("name", HINGED)
def test_energy_never_grows_unforced(name):
    """No current, no gravity, a kick: the kinetic energy never exceeds that of the kick."""
    dead = read_rig(name).changed(
        **{"servo.current_limit_a": 0.0, "world.gravity_m_s2": 0.0, "stiffness.prebend_rad": 0.0}
    )
    rig = build_rig(dead, 2, 1.0)
    inertia, rng = dead["servo.inertia_kg_m2"], np.random.default_rng(1)
    velocity = 0.3 * rng.standard_normal(rig.link.model.nv)
    velocity[rig.link.joints] = 0.0
    rig.data.qvel[:] = velocity

    def kinetic_j():
        import mujoco

        mujoco.mj_energyVel(rig.link.model, rig.data)
        return rig.data.energy[1] + sum(0.5 * inertia * s.rotor_rad_s**2 for s in rig.servos)

    history = [kinetic_j()]
    for _ in range(3000):
        rig.step()
        history.append(kinetic_j())
    assert max(history[1:]) <= history[0]
    assert max(history[-500:]) < 0.05 * history[0]


@pytest.mark.parametrize("name", HINGED)
def test_no_path_of_the_bends_draws_energy(name):
    rig = read_rig(name).changed(**{"stiffness.prebend_rad": 0.0})
    rig = rig.hide({"hysteresis": 0.3, "creep": 0.3, "cross_axis_coupling": 0.2})
    hinges, rng = rig.structure.hinges, np.random.default_rng(7)
    scale = np.array([0.05, *[0.08 / hinges] * hinges])[:, None]
    time = np.linspace(0.0, 1.0, 1500)[:, None, None]
    path = sum(
        scale * rng.normal(size=(hinges + 1, 2)) / k * np.sin(2 * np.pi * k * time)
        for k in (1, 3, 8)
    )
    law = BendLaw(rig, 1e-3)
    torque = np.array([law.torque_nm(angle) for angle in path])
    middle = -0.5 * (torque[1:] + torque[:-1])
    work = np.cumsum(np.sum(middle * np.diff(path, axis=0), axis=(1, 2)))
    assert work.min() > -1e-4 * work.max()


@pytest.mark.parametrize("name", HINGED)
def test_every_effect_of_link_and_servo_shows_in_every_structure(name):
    goal = np.array([0.25, 0.15])
    plain = course(build_rig(read_rig(name), 2, 0.5), 0.5, goal)
    noise = np.array([1e-4] * 3 + [2e-4, 0.02] * 2)
    for effect in STRENGTH.keys() - OF_SENSORS:
        rig = read_rig(name).hide({effect: STRENGTH[effect]})
        hidden = course(build_rig(rig, 2, 0.5), 0.5, goal)
        assert np.any(np.abs(hidden - plain).max(axis=0) > noise), effect


@pytest.mark.parametrize("name", HINGED)
def test_strength_zero_is_absent_in_every_structure(name):
    """Memory and play without strength are no memory and no play."""
    zero = {"memory.hysteresis_share": 0.0, "memory.relaxing_share": 0.0, "servo.backlash_rad": 0.0}
    rig = read_rig(name).changed(**zero)
    assert not relaxation_spectrum(rig).fractions.any()
    law, once = BendLaw(rig, 1e-3), BendLaw(rig, 1e-3)
    bends = 0.004 * np.random.default_rng(2).standard_normal((50, rig.structure.hinges + 1, 2))
    for bend in bends:
        torque = law.torque_nm(bend)
    np.testing.assert_allclose(torque, once.torque_nm(bends[-1]), atol=1e-12)
    changed = rig.hide(dict.fromkeys(CATALOGUE, 0.0))
    assert changed.sha256() == rig.sha256()


def test_hinges_change_the_link_but_hardly_the_sag():
    """The discrete link converges to the beam: tips of 5 and 17 hinges agree within 5 %."""
    sags = []
    for hinges in (5, 17):
        rig = read_parameters().changed(
            **{"memory.hysteresis_share": 0.0, "memory.relaxing_share": 0.0,
               "stiffness.prebend_rad": 0.0, "stiffness.damping_s": 0.05}
        )  # fmt: skip
        object.__setattr__(rig, "structure", type(rig.structure)(hinges=hinges))
        built = build_rig(rig, 1, 1.0)
        log = course(built, 2.0, np.array([0.3]))
        sags.append(log[-1, 0] - rigid_tip_m(log[-1:, 3:4], 0.06, 0.95)[0, 0])
    assert sags[0] == pytest.approx(sags[1], rel=0.05)


def write(path, text):
    path.write_text(text)
    return path


HEAD = 'summary = "one"\npurpose = "test"\n[structure]\n'


def test_a_file_of_choices_changes_values_and_keeps_places(tmp_path):
    text = (
        HEAD + 'goal = "profile"\n[servo.backlash_rad]\nvalue = 0.002\nunit = "rad"\nsource = "us"'
    )
    rig = read_rig(str(write(tmp_path / "ours.toml", text)))
    assert rig.structure.goal == "profile" and rig["servo.backlash_rad"] == 0.002
    assert rig.hide({"backlash": 0.004})["servo.backlash_rad"] == pytest.approx(0.006)
    assert rig["link.mass_kg"] == read_parameters()["link.mass_kg"]


def test_a_copy_of_the_rig_is_still_a_rig(tmp_path):
    rig = read_rig(str(write(tmp_path / "rig.toml", RIG_TOML.read_text())))
    assert rig.sha256() == read_parameters().sha256()


@pytest.mark.parametrize(
    "text, named",
    [
        (HEAD + 'goal = "guessed"', "guessed"),
        (HEAD + "hinges = 4", ">= 5"),
        (HEAD + 'gaol = "held"', "gaol"),
        (HEAD.replace('"test"', '"fun"'), "purpose"),
        (HEAD.replace('summary = "one"\n', ""), "summary"),
        (HEAD + '[link.weight]\nvalue = 1.0\nunit = "kg"\nsource = "us"', "link.weight is unknown"),
        (HEAD + '[link.mass_kg]\nvalue = 1.0\nunit = "g"\nsource = "us"', "give it in kg"),
        (HEAD + '[servo.backlash_rad]\nvalue = 1.0\nunit = "rad"\nsource = "us"', "bounds"),
    ],
)
def test_a_damaged_structure_is_refused_in_one_sentence(tmp_path, text, named):
    with pytest.raises(InputError, match=named):
        read_rig(str(write(tmp_path / "ours.toml", text)))


QUICK = ["--amplitude-deg", "5", "--period", "0.3", "--payloads", "0.5", "--trials", "1"]


def simulate(out, *options):
    return main(["simulate", "--out", str(out), "--workers", "1", *QUICK, *options])


def test_a_named_structure_runs_is_recorded_and_is_not_told_by_the_trial(tmp_path, capsys):
    assert simulate(tmp_path, "--rig", "test_a", "--hide", "backlash=0.005") == DONE
    record = json.loads((tmp_path / "rig_conditions.json").read_text())
    (conditions,) = record["trials"].values()
    assert conditions["rig"] == "test_a" and conditions["structure"]["hysteresis"] == "dahl"
    for path in tmp_path.glob("dof*"):
        assert not any(word in path.read_text() for word in ("test_a", "backlash", "dahl"))
    assert simulate(tmp_path, "--rig", "test_b", "--hide", "backlash=0.005") == BAD_INPUT
    assert "other conditions" in capsys.readouterr().err


def test_an_unknown_structure_is_refused_with_those_that_there_are(tmp_path, capsys):
    assert simulate(tmp_path, "--rig", "nowhere") == BAD_INPUT
    error = capsys.readouterr().err
    assert all(name in error for name in NAMED)


def test_the_file_of_the_rig_is_not_replaced_by_a_trial(tmp_path, capsys):
    name = "dof1_payload0.5_trial1_sinusoid_5deg_period0.3s.toml"
    rig = write(tmp_path / name, RIG_TOML.read_text())
    assert simulate(tmp_path, "--rig", str(rig)) == BAD_INPUT
    assert "which is read; name another directory" in capsys.readouterr().err
    assert rig.read_text() == RIG_TOML.read_text()
    assert [p.name for p in tmp_path.iterdir()] == [name]
