"""Conditions of the link's trials: gravity, pressure, undeclared names."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from firmware_py.core.errors import InputError
from models.trials.checks.payloads import judge_conditions
from models.trials.checks.trials import check_trial, refuse_unusable

G = 9.81
MOUNTINGS = {
    "upright": (0.0, 0.0, -G), "hanging": (0.0, 0.0, G), "horizontal": (-G, 0.0, 0.0),
    "other side": (G, 0.0, 0.0),
}  # fmt: skip


@pytest.fixture
def swing(make_trial):
    """Function (true gravity, stated gravity, period) -> a trial of one joint.

    The joint carries 1.4 kg at 0.8 m with 5 N·m per ampere: weight, inertia and friction by the
    equation of a pendulum.
    """

    def make(true, stated, period_s=4.352):
        time_s = 0.017 * np.arange(560)
        w = 2 * np.pi / period_s
        angle = -0.5 * np.sin(w * np.maximum(time_s - 0.34, 0.0))
        x, _, z = MOUNTINGS[true]
        weight_nm = 1.4 * 0.8 * (x * np.cos(angle) - z * np.sin(angle))
        inertia_nm = -1.4 * 0.8**2 * w**2 * angle
        rate = np.gradient(angle, 0.017)
        noise = 0.02 * np.random.default_rng(3).standard_normal(len(angle))
        trial = make_trial(angle, period_s=period_s, rest_samples=20, gravity_m_s2=stated)
        current = (inertia_nm - weight_nm) / 5.0 + 0.4 * np.tanh(rate / 0.05) + noise
        return replace(trial, columns=trial.columns | {"current_1_a": current})

    return make


def gravity(trial):
    """Levels of the findings on gravity."""
    return [f.level for f in check_trial(trial).findings if f.cause == "gravity"]


@pytest.mark.parametrize("stated", MOUNTINGS)
@pytest.mark.parametrize("true", MOUNTINGS)
def test_gravity_is_compared_with_the_weight_that_the_current_holds(swing, true, stated):
    assert gravity(swing(true, MOUNTINGS[stated])) == ([] if true == stated else ["warning"])


def test_gravity_is_not_judged_by_a_fast_motion(swing):
    """At 1 s inertia outweighs gravity: a hanging link's current has an upright one's sign."""
    assert gravity(swing("hanging", MOUNTINGS["hanging"], period_s=1.0)) == []


@pytest.mark.parametrize("mounting", MOUNTINGS)
def test_a_current_with_the_wrong_sign_is_named_in_every_mounting(swing, mounting):
    trial = swing(mounting, MOUNTINGS[mounting])
    trial.columns["current_1_a"][:] *= -1
    assert gravity(trial) == []
    assert [f.cause for f in check_trial(trial).findings if f.cause == "current"] == ["current"]


@pytest.mark.parametrize(
    ("down_m_s2", "level"),
    [(9.78, None), (1.0, "refused"), (98.1, "refused"), (0.0, "warning"), (2.5, "warning")],
)
def test_gravity_is_that_of_the_earth_unless_a_balloon_carries_the_link(swing, down_m_s2, level):
    trial = swing("upright", (0.0, 0.0, -down_m_s2))
    assert gravity(trial) == ([level] if level else [])
    assert judge_conditions(trial, is_described=True) == []


def test_conditions_of_the_link_in_the_table_of_other_plants_are_refused(make_trial):
    trial = make_trial(0.5 * np.sin(0.05 * np.arange(200)), conditions={"payload_kg": 5.0})
    refused = [f for f in check_trial(trial).findings if f.level == "refused"]
    assert [f.cause for f in refused] == ["conditions"] and "payload_kg" in refused[0].text
    with pytest.raises(InputError, match=r"\[conditions\] names payload_kg"):
        refuse_unusable([trial])
    of_another_plant = msgspec.structs.replace(trial.meta, link_length_m=0.0)
    refuse_unusable([replace(trial, meta=of_another_plant)])
