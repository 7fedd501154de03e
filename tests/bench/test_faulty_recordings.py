"""Faults that the benchmark writes into recordings, and its figures."""

import numpy as np
import pytest

from bench.faulty_recordings import FAULTS, LATE_ROWS, fault_figures
from models.trials.trial import Trial, TrialMeta


@pytest.fixture
def trial():
    meta = TrialMeta(
        dof=1, payload_kg=0.0, trial=1, motion="steps", source="measured", period_s=1.0,
        rest_samples=1, conditions={"mass_kg": 0.4, "duty_gain_1": 2.0},
    )  # fmt: skip
    columns = {"time_s": 0.005 * np.arange(100), "angle_1_rad": np.linspace(0.1, 1.0, 100)}
    return Trial("log", meta, columns)


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_changes_one_thing_and_leaves_the_recording_as_it_was(trial, fault):
    before = {name: values.copy() for name, values in trial.columns.items()}
    faulty = FAULTS[fault][0](trial)
    changed = {k for k, v in faulty.meta.conditions.items() if v != trial.meta.conditions[k]}
    changed |= {k for k, v in faulty.columns.items() if not np.array_equal(v, before[k])}
    assert len(changed) == (fault != "nothing")
    if "late" in fault:
        late_rad, angle_rad = faulty.columns["angle_1_rad"], before["angle_1_rad"]
        assert np.array_equal(late_rad[LATE_ROWS:], angle_rad[:-LATE_ROWS])
    assert all(np.array_equal(v, before[k]) for k, v in trial.columns.items())


def test_a_look_alike_counts_for_the_class_and_another_name_is_wrong():
    def row(fault, named, right, class_right):
        return {"fault": fault, "named": named, "right": right, "class_right": class_right}

    weight = "weight declared 25 % low"
    rows = [
        row("nothing", [], True, True), row(weight, ["unmodelled_payload"], True, True),
        row(weight, ["torque_constant_drift"], False, True), row(weight, [], False, False),
        row(weight, ["cogging"], False, False),
    ]  # fmt: skip
    found = fault_figures(rows)
    assert [found[k]["fraction"] for k in ("named", "class_right", "wrong")] == [0.25, 0.5, 0.25]
    assert found["by_fault"]["nothing"]["fraction"] == 1
    assert found["by_fault"]["encoder off by 50 mrad"] == {"of": 0}
