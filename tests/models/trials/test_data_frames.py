"""Data frames of trials: units in the names, and the trial that comes back."""

import numpy as np
import pytest

from firmware_py.core.errors import InputError
from firmware_py.core.signals import unit_of
from models.trials import data_frames
from models.trials.data_frames import as_data_frame, trial_frame, trial_from_frame, trials_frame
from models.trials.trial import Trial, TrialMeta


@pytest.fixture
def trial(toy_trials):
    toy = toy_trials(1, amplitudes_deg=(30,), trials=(1,), payloads_kg=(1.0,))[0]
    toy.columns["m03_x_m"][5:8] = np.nan
    return toy


def test_a_trial_comes_back_from_its_frame(trial):
    frame = trial_frame(trial)
    assert all(unit_of(name) for name in frame.columns)
    back = trial_from_frame(frame)
    assert (back.name, back.meta) == (trial.name, trial.meta)
    assert back.sha256() == trial.sha256()
    half = trial_from_frame(frame[: len(frame) // 2], name="half")
    assert len(half) == len(trial) // 2 and half.meta == trial.meta


def test_trials_stand_below_each_other(toy_trials):
    trials = toy_trials(1, amplitudes_deg=(30,), trials=(1, 2), payloads_kg=(0.0, 2.0))
    frame = trials_frame(trials)
    assert len(frame) == sum(len(t) for t in trials)
    means = frame.groupby("payload_kg")["current_1_a"].std()
    assert means[2.0] > means[0.0]  # more weight, more current
    assert list(frame.groupby("name").size()) == [len(t) for t in trials]
    with pytest.raises(InputError, match="are none"):
        trials_frame([])


FAULTS = {
    "convert it if it is in degrees": lambda f: f.assign(angle_1_rad=np.degrees(f["angle_1_rad"])),
    "row 5, column 'current_1_a'": lambda f: f.assign(
        current_1_a=f["current_1_a"].where(f.index != 3)
    ),
    "goal_1_rad is missing": lambda f: f.drop(columns="goal_1_rad"),
    "no unit suffix": lambda f: f.assign(temperature=20.0),
    "holds no numbers": lambda f: f.assign(angle_1_rad="x"),
    "resample": lambda f: f.assign(time_s=f["time_s"] + 0.005 * (f.index == 7)),
    "at least three": lambda f: f[:2],
}


@pytest.mark.parametrize("message", FAULTS)
def test_a_frame_that_is_no_trial_is_refused(trial, message):
    frame = trial_frame(trial)
    with pytest.raises(InputError, match=message):
        trial_from_frame(FAULTS[message](frame), trial.name, trial.meta)


@pytest.mark.parametrize(
    ("attrs", "message"), [({"name": "x"}, "give a TrialMeta"), ({}, "has no name")]
)
def test_a_frame_without_name_or_conditions_is_refused(trial, attrs, message):
    frame = trial_frame(trial)
    frame.attrs = attrs
    with pytest.raises(InputError, match=message):
        trial_from_frame(frame)


def test_a_trial_of_another_plant_needs_its_signals():
    from models.plant.plant import NOMINAL, read_plant

    plant = read_plant(NOMINAL.parent / "examples" / "emps.toml")
    meta = TrialMeta(dof=1, payload_kg=0.0, trial=1, motion="rest", source="measured",
                     period_s=1.0, rest_samples=1)  # fmt: skip
    columns = {"time_s": np.arange(5) * 1e-3, "position_1_m": np.zeros(5)}
    columns |= {n: np.zeros(5) for n, s in plant.signals.items() if s.role == "goal"}
    frame = trial_frame(Trial("rest", meta, columns))
    assert trial_from_frame(frame, signals=plant.signals).meta == meta
    with pytest.raises(InputError, match="pressure_pa is missing"):
        trial_from_frame(frame)


def test_without_pandas_one_sentence_says_how_to_get_it(monkeypatch):
    def without(name):
        raise ModuleNotFoundError(name)

    monkeypatch.setattr(data_frames.importlib, "import_module", without)
    with pytest.raises(InputError, match=r"pandas: is not installed; .*dropstitch\[library\]"):
        as_data_frame({})
