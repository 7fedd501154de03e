"""Notes on the trials of a diagnosis, and conditions that no trial of the plant has."""

import numpy as np
import pytest
from msgspec.structs import replace

from models.gap.estimation.noise_floor import NoiseFloor
from models.gap.estimation.transfer import motion_of
from models.gap.outliers import OutlierTrial
from models.gap.report.gap_json import ChangedCondition, NoiseFloorSummary
from models.gap.report.trial_notes import changed_conditions, notes_in_words
from models.gap.residuals.localisation import motion_in_words
from models.gap.settings import GapSettings
from models.plant.document import FittedTrial, Provenance
from models.plant.identification.noise_floor import trial_group_key
from models.trials.trial import Trial, TrialMeta

SPECTRUM = np.ones(3)
KEY = "1dof sinusoid 0.5236rad 4.352s 0rad 572x0.017s"


@pytest.fixture
def notes(document):
    """Function -> notes of a document whose plant's own error is known as stated."""

    def make(own_error="measured", larger=(), keys=("1dof steps",), **changes):
        floor = NoiseFloorSummary(True, {"di": None}, dict.fromkeys(keys, own_error), dict(larger))
        return notes_in_words(replace(document(), noise_floor=floor, **changes))

    return make


def test_plain_trials_need_no_note(notes):
    assert notes() == []


def test_everything_that_a_reader_has_to_know_is_noted(notes):
    text = " ".join(
        notes(
            "unknown", larger={"2": 3.9}, goal_not_followed_at_row={"heavy": 310},
            rows_fitted={"long": 5000}, settings=GapSettings(same_link=True),
            odd_trials=(OutlierTrial("p2_r2", "p2_r2.csv", 1.0, 8.9, 1.6),),
        )
    )  # fmt: skip
    for words in (
        "p2_r2 (1 kg) is left out", "8.9 noise floors", "heavy from row 310", "5000 of long",
        "identify the plant on trials of this motion too: 1dof steps", "3.9 times at 2 kg",
        "The link is taken",
    ):  # fmt: skip
        assert words in text


@pytest.mark.parametrize(
    ("condition", "words"),
    [
        (("step_s", "s", (0.017,), (0.02,)), "Rows are 20.0\u00a0ms apart, 17.0\u00a0ms"),
        (("payload_kg", "kg", (0.0, 1.0), (0.5,)), "identified with 0, 1 kg, not with 0.5 kg"),
        (("pressure_pa", "Pa", (41300.0,), (35e3,)), "is 35000 Pa, 41300 Pa in the trials"),
    ],
)
def test_changed_conditions_are_noted(notes, condition, words):
    (note,) = notes(changed_conditions=(ChangedCondition(*condition),))
    assert words in note


def provenance(pressure_pa=41300.0):
    return Provenance(fitted_trials=(FittedTrial("a", "12", "measured", "", pressure_pa),))


def test_conditions_are_compared_with_those_of_the_plant(make_trial):
    def trial(step_s=0.017, **changes):
        found = make_trial(np.zeros(50), **changes)
        found.columns["time_s"] = step_s * np.arange(50)
        return found

    curves = {KEY: {payload_kg: {"di": SPECTRUM} for payload_kg in (0.0, 2.0)}}
    floor = NoiseFloor(np.arange(3.0), {"di": SPECTRUM}, {"di": SPECTRUM}, curves)
    same = [trial(payload_kg=2.0, pressure_pa=41500.0), trial(payload_kg=0.01)]
    assert changed_conditions(provenance(), floor, same) == ()
    changed = [trial(0.02, payload_kg=1.0, pressure_pa=35e3), trial(payload_kg=2.0)]
    rows = {row.condition: row for row in changed_conditions(provenance(), floor, changed)}
    assert rows["step_s"].trials == pytest.approx((0.02,))
    assert rows["step_s"].plant == (0.017,)
    assert (rows["payload_kg"].plant, rows["payload_kg"].trials) == ((0.0, 2.0), (1.0,))
    assert 35e3 in rows["pressure_pa"].trials
    unknown = NoiseFloor(np.arange(3.0), {}, {}, learned=False)
    assert changed_conditions(provenance(0.0), unknown, changed) == ()


def test_groups_of_trials_are_named_in_words(notes):
    def noted(*keys):
        (note,) = notes("unknown", keys=keys)
        return note.replace("\u00a0", " ").split("too: ")[1]

    meta = TrialMeta(
        dof=2, payload_kg=1.0, trial=1, motion="sinusoid", source="rig", period_s=4.352,
        amplitude_rad=np.radians(30), phase_2_rad=np.pi / 2, rest_samples=60,
        conditions={"load_mass_kg": 0.5},
    )  # fmt: skip
    columns = {"time_s": 0.017 * np.arange(572)}
    key = trial_group_key(Trial("one", meta, columns))
    words = "sinusoid of ±30°, period 4.352 s, joint 2 leads by 90°, two joints, load mass 0.5 kg"
    assert noted(key) == f"{motion_in_words(motion_of(key))}." == f"{words}."
    short = trial_group_key(Trial("short", meta, {"time_s": 0.017 * np.arange(300)}))
    assert noted(key, short) == f"{words}, 572 rows of 17.0 ms; {words}, 300 rows of 17.0 ms."
    assert noted("1dof steps 0.3491rad 0s 0rad 572x0.017s") == "steps of ±20°, one joint."
    assert noted("of another form") == "of another form."
