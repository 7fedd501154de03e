"""Notes on the trials of a diagnosis."""

from types import SimpleNamespace

from models.gap.report.trial_notes import notes_in_words


def document(curve="measured", amplification=(), patterns="measured", signals=("di",),
             key="1dof steps", **others):  # fmt: skip
    floor = SimpleNamespace(
        learned=True, amplification=dict(amplification), signals=dict.fromkeys(signals),
        own_error={key: SimpleNamespace(curve=curve, patterns=patterns)}, steps_s=(0.017,),
    )  # fmt: skip
    plain = {"goal_not_followed_at_row": {}, "nuisance_bias": {}, "rows_fitted": {}}
    return SimpleNamespace(noise_floor=floor, **plain | others)


def test_nothing_is_noted_of_plain_trials():
    assert notes_in_words(document()) == []


def test_everything_that_a_reader_has_to_know_is_noted():
    found = document(
        "unknown", {"2": 3.9}, goal_not_followed_at_row={"heavy": 310},
        nuisance_bias={"sync_s": 14.2}, rows_fitted={"long": 5000},
    )  # fmt: skip
    said = "; ".join(notes_in_words(found))
    for words in (
        "heavy from row 310", "sync_s by +14 standard deviations", "5000 of long",
        "not subtracted, for: 1dof steps", "3.9 times at 2 kg",
    ):  # fmt: skip
        assert words in said


def test_patterns_that_nobody_measured_are_noted_with_the_command_that_does():
    (note,) = notes_in_words(document(patterns="unknown"))
    assert "python -m models calibrate" in note and "1dof steps" in note
    assert notes_in_words(document(patterns="transferred")) == []
    (note,) = notes_in_words(document("unknown", patterns="unknown"))
    assert "calibrate" not in note
    assert notes_in_words(document(patterns="unknown", signals=("angle_1_rad",))) == []


def test_trials_of_another_step_than_those_of_the_plant_are_noted():
    assert notes_in_words(document(key="1dof steps 572x0.017s")) == []
    (note,) = notes_in_words(document(key="1dof steps 486x0.02s"))
    assert "rows are 20 ms apart, 17 ms in the trials of the plant" in note
