"""Trials that a plant makes, with sensor noise and trial variation, and their diagnoses."""

import functools
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from firmware_py.core.motion import Motion
from firmware_py.core.signals import PERIOD_S
from models.gap.diagnosis import diagnose
from models.gap.residuals.fit_parameters import candidate_effects
from models.gap.settings import DEFAULT_SETTINGS
from models.plant.identification.noise_floor import with_noise_floor
from models.plant.plant import read_plant
from models.plant.simulation.runner import CompiledModel, run_trial
from models.plant.step_model import names
from models.trials.trial import Trial, TrialMeta, TrialSet

NOISE = {"rad": 1e-5, "a": 0.02, "di": 1e-4, "m": 2e-4}
REST_ROWS, CYCLE_ROWS = 60, 153
CONSIDERED = (
    "dead_time", "current_bias", "current_scale", "viscous_friction", "creep",
    "unmodelled_payload", "marker_frame_tilt",
)  # fmt: skip
DEAD_ZONES = ("backlash", "current_saturation")
VARIATION = {"pressure": 0.01, "friction": 0.05, "sync_s": 0.002, "frame_m": 0.0003}


def make_trials(plant, seed, payloads=(0.0, 1.0), repeats=2, dof=1):
    """Trials of a plant, each with its own pressure, friction, clock and frame.

    One cycle is shorter than the study's motion and saves time.
    """
    rng = np.random.default_rng(seed)
    rich = plant.with_effects("sync_offset")
    compiled = CompiledModel(rich.step_model(dof, "twin"))
    known, outputs = names(compiled.model.parameters), names(compiled.model.outputs)
    motion = Motion(period_s=CYCLE_ROWS * PERIOD_S, phase_2_rad=np.pi / 2, dof=dof)
    goal = motion.table_rad(rest_samples=REST_ROWS)[: REST_ROWS + CYCLE_ROWS]
    trials = []
    for payload_kg in payloads:
        for number in range(1, repeats + 1):
            meta = TrialMeta(
                dof=dof, payload_kg=payload_kg, pressure_pa=41300.0, trial=number,
                motion="sinusoid", source="test", period_s=motion.period_s,
                amplitude_rad=motion.amplitude_rad, base_offset_m=0.06, link_length_m=0.95,
                link_width_m=0.15, rest_samples=REST_ROWS,
            )  # fmt: skip
            trial = Trial(
                f"payload{payload_kg:g}_{number}", meta,
                {"time_s": PERIOD_S * np.arange(len(goal))}
                | {f"goal_{j + 1}_rad": row for j, row in enumerate(goal.T)},
            )  # fmt: skip
            p = compiled.model.parameter_values()
            stiff, rough = 1 + np.array(
                [VARIATION["pressure"], VARIATION["friction"]]
            ) * rng.normal(size=2)
            for k, name in enumerate(known):
                if name.endswith("stiffness_1_nm_rad") or name == "root_limit_moment_nm":
                    p[k] *= stiff
                if "_friction_" in name:
                    p[k] *= rough
            p[known.index("sync_offset_s")] += VARIATION["sync_s"] * rng.standard_normal()
            y = run_trial(compiled, trial, p)
            shift = VARIATION["frame_m"] * rng.standard_normal(3)
            columns = dict(trial.columns)
            for k, name in enumerate(outputs):
                noise = NOISE[name.rsplit("_", 1)[-1]] * rng.standard_normal(len(y))
                moved = shift["xyz".index(name[4])] if name.startswith("tip_") else 0.0
                columns[name] = y[:, k] + noise + moved
            trials.append(replace(trial, columns=columns))
    return TrialSet(tuple(trials))


@pytest.fixture(scope="session")
def trials_of():
    """Function (plant, seed, payloads, repeats) -> trials as that plant makes them."""
    return make_trials


@pytest.fixture(scope="session")
def plant():
    """Nominal plant with the noise floor and the provenance of its own trials."""
    trials = make_trials(read_plant(), 1).trials
    plant = with_noise_floor(read_plant(), trials)
    fitted = plant.provenance.fitted_with(trials)
    return replace(
        plant, provenance=msgspec.structs.replace(plant.provenance, fitted_trials=fitted)
    )


@pytest.fixture(scope="session")
def hidden(plant):
    """Function (parameter=change, …) -> trials of two payloads of the plant with these changes.

    Their seed is not that of the noise floor.
    """

    @functools.cache
    def hide(**strengths):
        full = plant.with_effects(*candidate_effects(plant))
        values = {name: full.parameters[name].value + s for name, s in strengths.items()}
        return make_trials(full.with_values(values), 7, (0.0, 1.0))

    return hide


@pytest.fixture(scope="session")
def diagnosed():
    """Function (plant, trials, effects, …) -> diagnosis over these effects alone.

    With `dead_zones` over those of `DEAD_ZONES` too, whose search takes as long as all others.
    """

    def run(plant, trials, effects=CONSIDERED, settings=DEFAULT_SETTINGS, dead_zones=False):
        effects = (*effects, *DEAD_ZONES) if dead_zones else effects
        others = [e for e in candidate_effects(plant) if e not in effects]
        return diagnose(plant, trials, leave_out=others, settings=settings)

    return run


def assert_no_worse_held_out(diagnosis):
    """The written plant errs by no more than 5 % more on held-out trials, in every signal."""
    ratios = diagnosis.written.errors.ratios(diagnosis.held_out_baseline)
    assert max(ratios.values()) <= 1.05


@pytest.fixture(scope="session")
def late(plant, hidden, diagnosed):
    """Diagnosis of 20 ms of dead time."""
    return diagnosed(plant, hidden(dead_time_1_s=0.02))
