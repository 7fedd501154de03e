"""Hidden effects: each adds to its parameter, shows where it should, and in its joint alone."""

import functools

import numpy as np
import pytest

from firmware_py.core.errors import InputError
from models.rig.drawn import rig_named
from models.rig.parameters import named_structures, read_parameters
from models.rig.protocol import build_rig, run_case
from models.shared.catalogue import CATALOGUE
from tests.models.rig.rigs import QUICK, STRENGTH, run, tip_m


@pytest.fixture(scope="module")
def hidden(short, short_case):
    """Trial with an effect: the same seed and noise as `default_trial`."""
    return functools.cache(lambda effect: run_case(
        short.hide({effect: STRENGTH[effect.partition(":")[0]]}), short_case()
    ))  # fmt: skip


def rms(values):
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.parametrize("name", named_structures())
def test_every_effect_has_the_same_parameter_in_every_structure(name):
    rig = rig_named(name)
    assert rig.effects() == read_parameters().effects()
    assert set(rig.effects()) == set(CATALOGUE) == set(STRENGTH)
    for effect, parameter in rig.effects().items():
        changed = rig.hide({effect: STRENGTH[effect]})
        assert {n for n in rig if changed[n] != rig[n]} == {parameter}
        assert changed[parameter] == pytest.approx(rig[parameter] + STRENGTH[effect])
        assert changed.entries[parameter].unit == CATALOGUE[effect].unit


def test_strength_zero_is_no_effect(short, short_case, default_trial):
    nothing = short.hide(dict.fromkeys(CATALOGUE, 0.0))
    assert nothing.sha256() == short.sha256()
    assert run_case(nothing, short_case()).sha256() == default_trial.sha256()


OF_SENSORS = ("current_bias", "current_scale", "marker_frame_tilt", "marker_scale", "pressure_leak",
              "sync_offset")  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("effect", OF_SENSORS)
def test_every_effect_of_a_sensor_shows_above_the_noise(effect, hidden, default_trial):
    trial = hidden(effect)
    moved_m = rms(trial.tip_m - default_trial.tip_m)
    assert moved_m > 3e-4 or rms(trial.current_a - default_trial.current_a) > 0.03


@pytest.mark.slow
@pytest.mark.parametrize("number, name", [(0, "default"), (1, "test_a"), (2, "test_b")])
def test_every_effect_of_link_and_servo_shows(number, name):
    """Each in one structure."""

    def course(rig):
        """Tip, encoder and sampled current in every control period."""
        built, log = build_rig(rig, 2, 0.5), []
        for _ in range(29):
            built.send(np.array([0.25, 0.15]))
            run(built, 0.017)
            servos = [(s.encoder_rad, s.sampled_current_a) for s in built.servos]
            log.append([*tip_m(built), *np.ravel(servos)])
        return np.array(log)

    plain, noise = course(rig_named(name)), np.array([1e-4] * 3 + [2e-4, 0.02] * 2)
    for effect in sorted(STRENGTH.keys() - set(OF_SENSORS))[number::3]:
        changed = course(rig_named(name).hide({effect: STRENGTH[effect]}))
        assert np.any(np.abs(changed - plain).max(axis=0) > noise), effect


def test_errors_of_the_mocap_move_the_markers_and_nothing_else(hidden, default_trial):
    tilt, delay_s = STRENGTH["marker_frame_tilt"], STRENGTH["sync_offset"]
    for effect in ("marker_frame_tilt", "sync_offset"):
        np.testing.assert_array_equal(hidden(effect).angle_rad, default_trial.angle_rad)
        np.testing.assert_array_equal(hidden(effect).current_a, default_trial.current_a)
    moved = hidden("marker_frame_tilt").tip_m - default_trial.tip_m
    np.testing.assert_allclose(moved[:, 0], np.sin(tilt) * default_trial.tip_m[:, 2], atol=1e-3)
    np.testing.assert_allclose(moved[:, 1], 0.0, atol=1e-6)
    late, prompt = hidden("sync_offset").tip_m[:, 0], default_trial.tip_m[:, 0]
    then = np.interp(default_trial.time_s - delay_s, default_trial.time_s, prompt)
    rows = slice(60 + int(delay_s / default_trial.step_s) + 1, None)
    assert rms((late - then)[rows]) < 0.1 * rms((late - prompt)[rows])


def test_a_saturated_current_stays_below_the_reduced_limit(hidden, default_trial):
    limit = 10.0 - STRENGTH["current_saturation"]
    assert np.abs(default_trial.current_a).max() > limit + 0.3
    assert np.abs(hidden("current_saturation").current_a).max() < limit + 0.15  # its noise


@pytest.mark.parametrize("effect", ["prebend", "payload_offset"])
def test_prebend_and_offset_payload_bend_the_resting_link_towards_plus_x(
    effect, hidden, default_trial
):
    rest = default_trial.meta.rest_samples
    sag = (hidden(effect).tip_m - default_trial.tip_m)[:rest].mean(axis=0)
    assert sag[0] > 5e-4
    assert abs(sag[1]) < 0.3 * sag[0]


# ---- in one joint --------------------------------------------------------------------------------


@pytest.mark.slow
def test_an_effect_in_each_joint_is_the_effect_in_both(short_case):
    effect = "backlash"
    rig, strength = rig_named("capture").changed(**QUICK), STRENGTH[effect]
    both = run_case(rig.hide({effect: strength}), short_case())
    each = run_case(rig.hide({f"{effect}:1": strength, f"{effect}:2": strength}), short_case())
    second = run_case(rig.hide({f"{effect}:2": strength}), short_case())
    assert each.sha256() == both.sha256() != second.sha256()


@pytest.mark.slow
@pytest.mark.parametrize("effect", ["coulomb_friction", "current_bias"])
def test_an_effect_in_one_joint_shows_in_that_joints_current(effect, hidden, default_trial):
    trial = hidden(f"{effect}:2")
    first_a, second_a = (
        rms(trial.current_a[:, j] - default_trial.current_a[:, j]) for j in (0, 1)
    )  # fmt: skip
    assert second_a > max(0.1, 2 * first_a)  # the joints act on each other


@pytest.mark.parametrize("rig", ["default", "cosserat"])
def test_both_engines_load_the_joint_that_has_the_offset(rig):
    built = build_rig(rig_named(rig).hide({"load_offset:2": 3.0}), 2, 1.0)
    assert [servo.load_nm for servo in built.servos] == [0.0, 3.0]


def test_strengths_in_a_joint_and_in_both_add_up(parameters):
    rig = parameters.hide({"coulomb_friction:2": 1.0, "coulomb_friction": 0.5})
    place = "servo.coulomb_friction_nm"
    assert rig.of_joint(1)[place] == rig[place] == parameters[place] + 0.5
    assert rig.of_joint(2)[place] == rig[place] + 1.0


@pytest.mark.parametrize(
    "hidden, message",
    [("coulomb_friction", r"coulomb_friction=-9.*choose -4\.5 to 25\.5"),
     ("prebend:2", "not of one joint alone"), ("backlash:3", "'3' is no joint"),
     ("backlash:2", "outside")],
)  # fmt: skip
def test_impossible_strengths_and_joints_are_refused(parameters, hidden, message):
    with pytest.raises(InputError, match=message):
        parameters.hide({hidden: -9.0})


def test_a_joint_that_is_not_driven_is_refused(short, short_case):
    with pytest.raises(InputError, match="joint 2, and 1 is driven"):
        run_case(short.hide({"backlash:2": 0.01}), short_case(dof=1))
