"""Hidden effects: every one has its place, adds to the default, and shows where it should."""

import math

import numpy as np
import pytest

from firmware_py.errors import InputError
from models.rig.parameters import RIG_TOML, read_parameters, read_rig
from models.rig.protocol import build_rig, draw_variation, run_case
from models.shared.catalogue import CATALOGUE
from models.shared.kinematics import rigid_tip_m
from tests.models.rig.strengths import STRENGTH


@pytest.fixture(scope="module")
def hidden(short, short_case):
    cache = {}

    def run(effect):
        if effect not in cache:
            cache[effect] = run_case(short.hide({effect: STRENGTH[effect]}), short_case())
        return cache[effect]

    return run


def rms(values):
    return float(np.sqrt(np.mean(values**2)))


def deflection_m(trial):
    return trial.tip_m - rigid_tip_m(trial.angle_rad, 0.06, 0.95)


def test_every_effect_of_the_catalogue_has_its_place(parameters):
    assert set(parameters.effects()) == set(CATALOGUE) == set(STRENGTH)


@pytest.mark.parametrize("effect", CATALOGUE)
def test_strength_adds_to_what_the_rig_has(parameters, effect):
    place = parameters.effects()[effect]
    assert parameters.hide({effect: STRENGTH[effect]})[place] == pytest.approx(
        parameters[place] + STRENGTH[effect]
    )
    changed = {n for n in parameters if parameters.hide({effect: 1e-6})[n] != parameters[n]}
    assert changed == {place}


def test_strength_zero_is_absent(short, short_case, default_trial):
    nothing = run_case(short.hide(dict.fromkeys(CATALOGUE, 0.0)), short_case())
    assert nothing.sha256() == default_trial.sha256()


@pytest.mark.parametrize("effect", CATALOGUE)
def test_every_effect_shows_above_the_noise(effect, hidden, default_trial):
    """Same seed, same noise: what differs is the effect."""
    trial = hidden(effect)
    tip, current = (
        rms(trial.tip_m - default_trial.tip_m), rms(trial.current_a - default_trial.current_a)
    )  # fmt: skip
    assert tip > 3e-4 or current > 0.03


@pytest.mark.parametrize("effect", ["current_bias", "current_scale"])
def test_errors_of_the_current_leave_the_rest_alone(effect, hidden, default_trial):
    trial = hidden(effect)
    np.testing.assert_array_equal(trial.markers_m, default_trial.markers_m)
    np.testing.assert_array_equal(trial.angle_rad, default_trial.angle_rad)
    fit = np.polyfit(default_trial.current_a.ravel(), trial.current_a.ravel(), 1)
    expected = {"current_bias": [1.0, 0.2], "current_scale": [1.1, 0.0]}[effect]
    np.testing.assert_allclose(fit, expected, atol=2e-3)


@pytest.mark.parametrize("effect", ["marker_frame_tilt", "marker_scale", "sync_offset"])
def test_errors_of_the_mocap_leave_the_servo_alone(effect, hidden, default_trial):
    trial = hidden(effect)
    np.testing.assert_array_equal(trial.angle_rad, default_trial.angle_rad)
    np.testing.assert_array_equal(trial.current_a, default_trial.current_a)


def test_a_tilted_frame_turns_the_markers_about_y(hidden, default_trial):
    tilt = STRENGTH["marker_frame_tilt"]
    moved = hidden("marker_frame_tilt").tip_m - default_trial.tip_m
    np.testing.assert_allclose(moved[:, 0], np.sin(tilt) * default_trial.tip_m[:, 2], atol=1e-3)
    np.testing.assert_allclose(moved[:, 1], 0.0, atol=1e-6)


def test_a_late_mocap_shows_what_was(hidden, default_trial):
    delay, step = STRENGTH["sync_offset"], default_trial.step_s
    late, prompt = hidden("sync_offset").tip_m[:, 0], default_trial.tip_m[:, 0]
    then = np.interp(default_trial.time_s - delay, default_trial.time_s, prompt)
    rows = slice(60 + int(delay / step) + 1, None)
    assert rms((late - then)[rows]) < 0.1 * rms((late - prompt)[rows])


def test_a_saturated_current_stays_below_the_limit_that_is_left(hidden, default_trial):
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


def test_the_firmware_follows_a_wrong_encoder(hidden, default_trial):
    """The angle reads as before, the link stands elsewhere."""
    trial, offset = hidden("encoder_offset"), STRENGTH["encoder_offset"]
    assert rms(trial.angle_rad - default_trial.angle_rad) < 0.05 * offset
    moved = (trial.tip_m - default_trial.tip_m)[:60].mean(axis=0)
    np.testing.assert_allclose(moved[:2], -1.01 * offset, rtol=0.2)


@pytest.fixture(scope="module")
def slow_lean(short, short_case):
    """Lean to both sides slowly, so that inertia does not confuse the picture."""
    case = short_case(
        dof=1, kind="triangle", amplitude_rad=math.radians(20.0), period_s=1.5, payload_kg=1.5
    )
    cache = {}

    def run(effect=None):
        if effect not in cache:
            strength = {effect: STRENGTH[effect]} if effect else {}
            cache[effect] = run_case(short.hide(strength), case)
        return cache[effect]

    return run


@pytest.mark.parametrize("effect", ["backlash", "joint_elasticity"])
def test_give_of_the_gear_moves_the_tip_behind_the_encoders_back(effect, slow_lean):
    plain, loose = slow_lean(), slow_lean(effect)
    seen_m = rms(loose.angle_rad - plain.angle_rad) * 1.01
    assert rms(loose.tip_m - plain.tip_m) > 5 * seen_m


@pytest.mark.parametrize(
    "effect, more",
    [("unmodelled_payload", True), ("stiffness_softening", True), ("stiffness_hardening", False),
     ("directional_stiffness", False), ("pressure_leak", True)],
)  # fmt: skip
def test_softer_or_heavier_links_bend_further(effect, more, slow_lean):
    rows = slice(60 + 230, 60 + 300)  # around the positive turning point
    plain, changed = (deflection_m(t)[rows, 0].mean() for t in (slow_lean(), slow_lean(effect)))
    assert (changed > plain * 1.02) if more else (changed < plain * 0.98)


def test_impossible_strengths_are_refused_with_the_range(parameters):
    with pytest.raises(InputError, match=r"coulomb_friction=-9.*choose -4\.5 to 25\.5"):
        parameters.hide({"coulomb_friction": -9.0})


def test_an_effect_without_a_place_is_refused_with_those_that_have_one(tmp_path):
    text = RIG_TOML.read_text().replace('effect = "backlash"\n', "")
    (tmp_path / "rig.toml").write_text(text)
    with pytest.raises(InputError, match=r"no place.*coulomb_friction, ") as error:
        read_parameters(tmp_path / "rig.toml").hide({"backlash": 0.01})
    assert ", backlash" not in error.value.remedy


@pytest.mark.parametrize(
    "old, new, named",
    [
        ("[link.mass_kg]\nvalue = 0.9", "[link.mass_kg]\nvalue = 'heavy'", "link.mass_kg"),
        ("[link.mass_kg]\nvalue = 0.9\nunit = \"kg\"", "[link.mass_kg]\nvalue = 900\nunit = \"g\"",
         "give it in kg"),
        ("[link.mass_kg]", "[link.weight]", "link"),
        ('effect = "backlash"', 'effect = "slop"', "slop"),
        ('effect = "backlash"', 'effect = "creep"', "creep"),
        ("[link.mass_kg]", "[link.mass_kg", "TOML"),
        ("value = 0.24", "value = -0.24", "bounds"),
    ],
)  # fmt: skip
def test_a_damaged_rig_file_is_refused(tmp_path, old, new, named):
    text = RIG_TOML.read_text()
    assert old in text
    (tmp_path / "rig.toml").write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=named):
        read_parameters(tmp_path / "rig.toml")


@pytest.mark.parametrize(
    "rig, effect",
    [("default", "encoder_ripple"), ("default", "current_scale"), ("capture", "backlash")],
)
def test_an_effect_in_each_joint_is_the_effect_in_both(rig, effect, short_case):
    own = read_rig(rig).changed(**{"world.settle_s": 0.3, "world.pause_s": 0.3})
    strength = STRENGTH[effect]
    both = run_case(own.hide({effect: strength}), short_case())
    each = run_case(own.hide({f"{effect}:1": strength, f"{effect}:2": strength}), short_case())
    second = run_case(own.hide({f"{effect}:2": strength}), short_case())
    assert each.sha256() == both.sha256() != second.sha256()


@pytest.mark.parametrize("effect", ["coulomb_friction", "current_bias", "viscous_friction"])
def test_an_effect_in_one_joint_shows_in_that_joints_current(
    effect, short, short_case, default_trial
):
    trial = run_case(short.hide({f"{effect}:2": STRENGTH[effect]}), short_case())
    first_a, second_a = (
        rms(trial.current_a[:, j] - default_trial.current_a[:, j]) for j in (0, 1)
    )  # fmt: skip
    assert second_a > max(0.1, 2 * first_a)  # the joints act on each other


@pytest.mark.parametrize("rig", ["default", "cosserat"])
def test_both_engines_load_the_joint_that_has_the_offset(rig):
    built = build_rig(read_rig(rig).hide({"load_offset:2": 3.0}), 2, 1.0)
    assert [servo.load_nm for servo in built.servos] == [0.0, 3.0]


def test_friction_in_one_joint_varies_between_trials_as_that_of_both(parameters, short_case):
    place = "servo.coulomb_friction_nm"
    rig = parameters.hide({"coulomb_friction:2": parameters[place]})
    varied = draw_variation(rig, short_case(), short_case().rng()).parameters
    assert varied[place] != rig[place]
    assert varied.of_joint(2)[place] == pytest.approx(2 * varied.of_joint(1)[place])


def test_what_is_hidden_in_a_joint_adds_to_what_is_hidden_in_both(parameters):
    rig = parameters.hide({"coulomb_friction:2": 1.0, "coulomb_friction": 0.5})
    place = "servo.coulomb_friction_nm"
    assert rig.of_joint(1)[place] == rig[place] == parameters[place] + 0.5
    assert rig.of_joint(2)[place] == rig[place] + 1.0


def test_the_hash_of_a_rig_tells_the_joint(parameters):
    first, second, both = (
        parameters.hide({name: 0.01}) for name in ("backlash:1", "backlash:2", "backlash")
    )
    assert len({r.sha256() for r in (parameters, first, second, both)}) == 4


@pytest.mark.parametrize(
    "hidden, told",
    [("prebend:2", "not of one joint alone"), ("backlash:3", "'3' is no joint"),
     ("backlash:2", "no joint|outside")],
)  # fmt: skip
def test_impossible_joints_are_refused(parameters, hidden, told):
    with pytest.raises(InputError, match=told):
        parameters.hide({hidden: -0.5})


def test_a_joint_that_is_not_driven_is_refused(short, short_case):
    with pytest.raises(InputError, match="joint 2, and 1 is driven"):
        run_case(short.hide({"backlash:2": 0.01}), short_case(dof=1))
