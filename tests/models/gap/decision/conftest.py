"""Pendulum whose trials cost milliseconds: its servo reports angle and supply voltage alone."""

import numpy as np
import pytest

from models.gap.diagnosis import diagnose
from models.gap.residuals.fit_parameters import candidate_effects
from models.plant.plant import read_plant
from models.plant.simulation.runner import CompiledModel, run_trial
from models.plant.step_model import names
from models.trials.trial import Trial, TrialMeta, TrialSet

STEP_S, NOISE_RAD, PERIODS_S = 0.005, 1e-3, (2.0, 1.3)


def _swings(plants, periods_s=PERIODS_S, seed=5):
    """Trials of each payload with the plant that stands for it: {payload in kg: plant}."""
    rng = np.random.default_rng(seed)
    time_s = STEP_S * np.arange(400)
    trials = []
    for payload_kg, plant in plants.items():
        compiled = CompiledModel(plant.step_model(1, "twin"))
        angle = names(compiled.model.outputs).index("angle_1_rad")
        for period_s in periods_s:
            meta = TrialMeta(
                dof=1, payload_kg=payload_kg, trial=1, motion=f"swing_{period_s}", source="test",
                period_s=period_s, rest_samples=0,
                conditions={"mass_kg": 0.5, "arm_length_m": 0.1, "duty_gain_1": 0.3},
            )  # fmt: skip
            columns = {
                "time_s": time_s,
                "goal_1_rad": 0.8 * np.sin(2 * np.pi * time_s / period_s),
                "enabled_1": np.ones(len(time_s)),
                "supply_1_v": np.full(len(time_s), 7.5),
            }
            name = f"load{payload_kg:g}_{period_s:g}"
            y = run_trial(compiled, Trial(name, meta, columns | {"angle_1_rad": 0 * time_s}))
            columns["angle_1_rad"] = y[:, angle] + NOISE_RAD * rng.standard_normal(len(y))
            trials.append(Trial(name, meta, columns))
    return TrialSet(tuple(trials))


@pytest.fixture(scope="session")
def swings():
    """Function ({payload in kg: plant}, periods_s) -> trials."""
    return _swings


@pytest.fixture(scope="session")
def pendulum():
    """Pendulum with viscous friction alone."""
    return read_plant("models/plant/examples/xl330_pendulum.toml")


@pytest.fixture(scope="session")
def rough(pendulum):
    """Function (Coulomb friction in N·m) -> the pendulum with it."""

    def make(friction_nm):
        return pendulum.with_effects("coulomb_friction").with_values(
            {"coulomb_friction_1_nm": friction_nm}
        )

    return make


@pytest.fixture(scope="session")
def diagnosed_with():
    """Function (plant, trials, effects) -> diagnosis over these effects alone."""

    def run(plant, trials, effects=("coulomb_friction",)):
        others = [e for e in candidate_effects(plant) if e not in effects]
        return diagnose(plant, trials, leave_out=others)

    return run
