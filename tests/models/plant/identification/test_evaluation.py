"""Errors of a plant on trials, and the part of them that is the motion capture's clock."""

from dataclasses import replace

import numpy as np
import pytest

from models.plant.document import CLOCK_LIMIT_S
from models.plant.identification.evaluation import evaluate_plant
from models.plant.plant import read_plant

LATE_S = (-0.0081, 0.0073)
"""Offsets that no whole number of steps makes."""


@pytest.fixture(scope="module")
def trials(synthetic):
    """Function (offsets) -> noisy trials whose motion capture is late by these."""
    plant = read_plant().with_effects("sync_offset")

    def make(offsets_s):
        rng = np.random.default_rng(5)
        made = [
            synthetic(plant.with_values({"sync_offset_s": late_s}), 1.0, count=420, rng=rng)
            for late_s in offsets_s
        ]
        return [replace(t, name=f"trial {k}") for k, t in enumerate(made)]

    return make


def test_the_clock_of_each_trial_is_separated_from_the_error_of_the_plant(trials):
    plant = read_plant()
    stiffness = plant.parameters["root_stiffness_1_nm_rad"]
    soft_plant = plant.with_values({stiffness.name: 0.94 * stiffness.value})
    punctual = evaluate_plant(soft_plant, trials([0.0] * len(LATE_S)))
    late = evaluate_plant(soft_plant, trials(LATE_S))
    assert punctual.clock_tip_rms_m == pytest.approx(punctual.tip_rms_m, rel=0.03)
    assert late.tip_rms_m > punctual.tip_rms_m + 1e-3
    assert late.clock_tip_rms_m == pytest.approx(punctual.clock_tip_rms_m, rel=0.02)
    differences_s = np.subtract(list(late.clocks_s.values()), list(punctual.clocks_s.values()))
    np.testing.assert_allclose(differences_s, LATE_S, atol=3e-4)
    assert late.dof["1"].payloads["1"].clock_tip_rms_m == late.clock_tip_rms_m
    assert late.rigid_tip_rms_m is not None
    text = late.summary().replace("\xa0", " ")
    assert f"clock refitted {1e3 * late.clock_tip_rms_m:.1f} mm" in text
    assert "limit" not in text


def test_a_trial_whose_clock_is_beyond_the_limit_is_named(trials):
    result = evaluate_plant(read_plant(), trials([0.02, 0.004]))
    assert result.clocks_s["trial 0"] == pytest.approx(CLOCK_LIMIT_S, rel=1e-3)
    assert result.clocks_s["trial 1"] == pytest.approx(0.004, abs=3e-4)
    assert result.clock_sentence().endswith(": trial 0")


def test_without_motion_capture_there_is_no_clock(trials):
    (trial,) = trials([0.0])
    columns = {n: v for n, v in trial.columns.items() if not n.startswith(("tip", "m"))}
    result = evaluate_plant(read_plant(), [replace(trial, columns=columns)])
    assert result.tip_rms_m is result.clock_tip_rms_m is None
    assert result.clocks_s == {}
    assert "end effector" not in result.summary()
