"""Loads on a joint that moves as measured, against textbook solutions."""

import numpy as np
import pytest
from scipy import signal

from models.plant.identification.evaluation import compare_with_trials
from models.plant.plant import read_plant
from models.trials.trial import Trial, TrialMeta

STEP_S = 0.002
TIME_S = np.arange(2000) * STEP_S


@pytest.fixture
def plant_of(tmp_path):
    def make(load, parameters, drive="measured", effects=()):
        path = tmp_path / "plant.toml"
        rows = "\n".join(f"{name} = {value}" for name, value in parameters.items())
        listed = ", ".join(f'{{ name = "{name}" }}' for name in effects)
        path.write_text(
            f'schema = 1\nname = "test"\ndrive = {{ kind = "{drive}" }}\n'
            f'load = {{ kind = "{load}" }}\neffects = [{listed}]\n[parameters]\n{rows}\n'
        )
        return read_plant(path)

    return make


def trial_of(**columns):
    meta = TrialMeta(
        dof=1, payload_kg=0.0, trial=1, motion="test", source="measured", period_s=4.0,
        rest_samples=0,
    )  # fmt: skip
    return Trial("test", meta, {"time_s": TIME_S, **columns})


LINK = {
    "link_inertia_kg_m2": 0.2, "root_stiffness_1_nm_rad": 20.0, "root_damping_1_nm_s_rad": 0.3,
    "follow_rate_per_s": 500.0,
}  # fmt: skip


def test_a_flexible_links_deflection_is_that_of_its_transfer_function(plant_of):
    """θ/q = −J s² / (J s² + c s + k) [a base-excited oscillator]."""
    angle_rad = 0.3 * np.sin(2 * np.pi * 0.7 * TIME_S) ** 2
    system = signal.lti([-0.2, 0, 0], [0.2, 0.3, 20.0])
    expected = signal.lsim(system, angle_rad, TIME_S)[1]
    trial = trial_of(angle_1_rad=angle_rad, deflection_1_rad=expected)
    (run,) = compare_with_trials(plant_of("flexible_link", LINK), [trial])
    error = run.error("deflection_1_rad")
    assert np.sqrt(np.mean(error**2)) < 0.01 * np.std(expected)


def test_a_flexible_link_may_begin_in_motion(plant_of):
    """Free decay of an underdamped oscillator from a deflection and a rate."""
    decay, omega = 0.3 / 0.4, np.sqrt(20.0 / 0.2 - (0.3 / 0.4) ** 2)
    expected = 0.05 * np.exp(-decay * TIME_S) * np.cos(omega * TIME_S + 0.7)
    trial = trial_of(angle_1_rad=np.full(len(TIME_S), 0.4), deflection_1_rad=expected)
    (run,) = compare_with_trials(plant_of("flexible_link", LINK), [trial])
    assert np.max(np.abs(run.error("deflection_1_rad"))) < 0.02 * 0.05
