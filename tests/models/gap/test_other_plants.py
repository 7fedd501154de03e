"""The gap workflow on plants that declare other signals than the link's."""

import numpy as np
import pytest

from dropstitch.__main__ import main
from models.gap.diagnosis import diagnose
from models.gap.residuals.fit_parameters import candidate_effects
from models.plant.plant import read_plant
from models.plant.simulation.runner import CompiledModel, run_trial
from models.plant.step_model import names
from models.trials.files import read_trials
from models.trials.trial import Trial, TrialMeta, TrialSet
from tests.real_data import real_recordings

pytestmark = pytest.mark.slow

EXAMPLES = "models/plant/examples"
STEP_S = 0.005
CONSIDERED = ("coulomb_friction", "current_saturation")


@pytest.fixture
def pendulum():
    return read_plant(f"{EXAMPLES}/xl330_pendulum.toml")


def swings(plant, seed):
    """Trials of a pendulum whose servo reports its angle and supply voltage, and no current."""
    rng = np.random.default_rng(seed)
    compiled = CompiledModel(plant.step_model(1, "twin"))
    angle = names(compiled.model.outputs).index("angle_1_rad")
    time_s = STEP_S * np.arange(400)
    trials = []
    for number, period_s in ((1, 2.0), (2, 1.3)):
        meta = TrialMeta(
            dof=1, payload_kg=0.0, trial=number, motion="sinusoid", source="test",
            period_s=period_s, rest_samples=0,
            conditions={"mass_kg": 0.5, "arm_length_m": 0.1, "duty_gain_1": 0.3},
        )  # fmt: skip
        columns = {
            "time_s": time_s,
            "goal_1_rad": 0.8 * np.sin(2 * np.pi * time_s / period_s),
            "enabled_1": np.ones(len(time_s)),
            "supply_1_v": np.full(len(time_s), 7.5),
        }
        trial = Trial(f"swing_{number}", meta, columns | {"angle_1_rad": 0 * time_s})
        y = run_trial(compiled, trial)
        columns["angle_1_rad"] = y[:, angle] + 1e-3 * rng.standard_normal(len(y))
        trials.append(Trial(trial.name, meta, columns))
    return TrialSet(tuple(trials))


def test_a_plant_without_a_measured_current_is_diagnosed(pendulum):
    full = pendulum.with_effects(*candidate_effects(pendulum))
    trials = swings(full.with_values({"coulomb_friction_1_nm": 0.05}), 5)
    others = [e for e in candidate_effects(pendulum) if e not in CONSIDERED]
    found = diagnose(pendulum, trials, leave_out=others)
    assert found.named == ("coulomb_friction",)
    q = found.improved.parameters["coulomb_friction_1_nm"]
    assert q.value == pytest.approx(0.05, rel=0.2)


def test_recordings_of_a_servo_without_a_current_sensor_are_diagnosed(tmp_path, capsys):
    """Two logs of each of two gains, with the effects that matter."""
    recordings = real_recordings("bam_xl330")
    trials = tmp_path / "trials"
    for gain in (100, 400):
        for motion in ("sin_sin", "lift_and_drop"):
            log = str(recordings / f"kp{gain}_{motion}.json")
            table = ["--as", "table", "--map", f"{EXAMPLES}/xl330_pendulum.map.toml"]
            assert main(["import", log, *table, "--out", str(trials)]) == 0
    plant = read_plant(f"{EXAMPLES}/xl330_pendulum.toml")
    kept = (*CONSIDERED, "load_dependent_friction")
    denied = [a for e in candidate_effects(plant) if e not in kept for a in ("--without", e)]
    out = tmp_path / "gap"
    code = main(["gap", str(trials), "--plant", f"{EXAMPLES}/xl330_pendulum.toml",
                 "--out", str(out), *denied])  # fmt: skip
    assert code in (0, 1), capsys.readouterr().err
    improved = read_plant(out / "plant.json")
    assert len(read_trials(trials, improved.signals)) == 4
    assert "load_dependent_friction" in improved.effects
