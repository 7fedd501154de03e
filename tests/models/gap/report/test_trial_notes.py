"""Notes on the trials of a diagnosis."""

from types import SimpleNamespace

import numpy as np
import pytest

from models.gap.estimation.curve_transfer import motion_of
from models.gap.odd_trials import OddTrial
from models.gap.report.changed_conditions import ChangedCondition
from models.gap.report.trial_notes import notes_in_words
from models.gap.residuals.group_words import motion_in_words
from models.gap.settings import DEFAULT_SETTINGS, GapSettings
from models.plant.identification.noise_floor import trial_group_key
from models.trials.trial import Trial, TrialMeta


def document(curve="measured", amplification=(), patterns="measured", signals=("di",), **others):
    floor = SimpleNamespace(
        learned=True, amplification=dict(amplification), signals=dict.fromkeys(signals),
        own_error={"1dof steps": SimpleNamespace(curve=curve, patterns=patterns)},
    )  # fmt: skip
    plain = {
        "goal_not_followed_at_row": {},
        "nuisance_bias": {},
        "rows_fitted": {},
        "changed_conditions": (),
        "settings": DEFAULT_SETTINGS,
        "refused": [],
        "odd_trials": (),
    }
    return SimpleNamespace(noise_floor=floor, **plain | others)


def test_a_trial_that_was_left_out_is_noted_with_its_size():
    (said,) = notes_in_words(document(odd_trials=(OddTrial("p2_r2", "p2_r2.csv", 1.0, 8.9, 1.6),)))
    assert all(word in said for word in ("p2_r2 (1 kg)", "8.9 noise floors", "1.6"))


def test_nothing_is_noted_of_plain_trials():
    assert notes_in_words(document()) == []


def test_everything_that_a_reader_has_to_know_is_noted():
    found = document(
        "unknown", {"2": 3.9}, goal_not_followed_at_row={"heavy": 310},
        nuisance_bias={"friction": 14.2, "frame_m tip_z_m": -13.0}, rows_fitted={"long": 5000},
    )  # fmt: skip
    said = "; ".join(notes_in_words(found))
    for words in (
        "heavy from row 310", "friction by +14 standard deviations", "mocap frame along z by -13",
        "5000 of long",
        "identify the plant on trials of this motion too, for: 1dof steps", "3.9 times at 2 kg",
    ):  # fmt: skip
        assert words in said


def test_an_improbable_effect_asks_whether_the_link_is_the_same_until_that_is_said():
    refused = [
        SimpleNamespace(effect="creep", kind="improbable"),
        SimpleNamespace(effect="backlash", kind="held-out error"),
        SimpleNamespace(effect="sensor_lag", kind="stand-in"),
    ]
    (note,) = notes_in_words(document(refused=refused))
    assert "like creep:" in note and "--same-link" in note
    assert notes_in_words(document(refused=refused[1:])) == []
    assert notes_in_words(document(refused=refused, signals=("angle_1_rad",))) == []
    same = GapSettings(same_link=True)
    (note,) = notes_in_words(document(refused=refused, settings=same))
    assert "as said" in note and "--same-link" not in note


def test_that_the_values_of_a_plant_count_as_known_is_noted():
    (note,) = notes_in_words(document(settings=GapSettings(plant_is_known=True)))
    assert "known within 5%" in note and "identify a plant" in note


def test_patterns_that_nobody_measured_are_noted_with_the_command_that_does():
    (note,) = notes_in_words(document(patterns="unknown"))
    assert "dropstitch calibrate" in note and "1dof steps" in note
    assert notes_in_words(document(patterns="transferred")) == []
    (note,) = notes_in_words(document("unknown", patterns="unknown"))
    assert "calibrate" not in note
    assert notes_in_words(document(patterns="unknown", signals=("angle_1_rad",))) == []


@pytest.mark.parametrize(
    ("condition", "said"),
    [
        (
            ("step_s", "s", (0.017,), (0.02,)),
            "rows are 20.0\u00a0ms apart, 17.0\u00a0ms",
        ),
        (("payload_kg", "kg", (0.0, 1.0), (0.5,)), "identified with 0, 1 kg, not with 0.5 kg"),
        (("pressure_pa", "Pa", (41300.0,), (35e3,)), "is 35000 Pa, 41300 Pa in the trials"),
    ],
)
def test_conditions_of_no_trial_of_the_plant_are_noted(condition, said):
    (note,) = notes_in_words(document(changed_conditions=[ChangedCondition(*condition)]))
    assert said in note


def noted(keys):
    found = document("unknown")
    found.noise_floor.own_error = {k: SimpleNamespace(curve="unknown", patterns="") for k in keys}
    (note,) = notes_in_words(found)
    return note.replace("\u00a0", " ").split("for: ")[1]


def test_groups_of_trials_are_told_in_words():
    meta = TrialMeta(
        dof=2, payload_kg=1.0, trial=1, motion="sinusoid", source="rig", period_s=4.352,
        amplitude_rad=np.radians(30), phase_2_rad=np.pi / 2, rest_samples=60,
        conditions={"load_mass_kg": 0.5},
    )  # fmt: skip
    columns = {"time_s": 0.017 * np.arange(572)}
    key = trial_group_key(Trial("one", meta, columns))
    words = "sinusoid of ±30°, period 4.352 s, joint 2 leads by 90°, two joints, load mass 0.5 kg"
    assert noted([key]) == motion_in_words(motion_of(key)) == words
    short = trial_group_key(Trial("short", meta, {"time_s": 0.017 * np.arange(300)}))
    assert noted([key, short]) == f"{words}, 572 rows of 17.0 ms; {words}, 300 rows of 17.0 ms"
    assert noted(["1dof steps 0.3491rad 0s 0rad 572x0.017s"]) == "steps of ±20°, one joint"
    assert noted(["of another form"]) == "of another form"
