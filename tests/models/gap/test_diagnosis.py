"""Diagnosis of trials of a plant whose missing effect is known: it is named, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest

from firmware_py.core.errors import InputError
from models.bundle.train import refuse_fitted
from models.gap.decision.certainty import knowledge_of
from models.gap.decision.written_fit import PlantWriter
from models.gap.diagnosis import diagnose
from models.gap.improved_plant import improved_plant
from models.gap.report.gap_results import gap_document
from models.gap.report.gap_words import gap_in_words
from models.gap.settings import GapSettings
from models.plant.identification.evaluation import compare_with_trials
from models.plant.identification.noise_floor import with_noise_floor
from models.plant.plant import read_plant
from models.trials.trial import TrialSet
from tests.models.gap.conftest import assert_no_worse_held_out
from tests.models.made_trials import with_columns, with_conditions

FEW = ("backlash", "creep", "viscous_friction", "unmodelled_payload")
GAINS = ("dead_time", "position_gain_change", "sync_offset", "viscous_friction")
CLOCKS = ("sync_offset", "dead_time", "creep", "marker_frame_tilt")


@pytest.fixture(scope="module")
def nothing(plant, hidden, diagnosed):
    """Diagnosis of trials in which nothing is missing."""
    return diagnosed(plant, hidden(), dead_zones=True)


def test_without_a_hidden_effect_nothing_is_named(nothing):
    assert nothing.verdict == "no gap" and nothing.named == ()
    assert nothing.improved.parameters == nothing.plant.parameters
    assert "current_saturation" in nothing.naming.search.unexcited, "no trial reaches the limit"
    assert not nothing.floor.amplification_power, "repetitions differ as expected"
    assert_no_worse_held_out(nothing)


def test_a_link_whose_parameters_the_fit_moves_counts_as_another_one(nothing):
    estimator, point = nothing.naming.search.estimator, nothing.naming.search.nothing.point
    link = [q.name.startswith(("root_", "span_")) and q.kind == "nuisance"
            for q in estimator.residuals.fit_parameters]  # fmt: skip
    deviation = np.array([q.standard_deviation for q in estimator.residuals.fit_parameters])
    moved = replace(point, values=np.where(link, -4 * deviation, point.values))
    assert knowledge_of(estimator, point) == "identified"
    assert knowledge_of(estimator, moved) == "other link"


def test_a_dead_time_is_named_with_its_value_and_added(late):
    assert late.named[0] == "dead_time" and late.verdict == "closed" and late.outliers == ()
    q = late.improved.parameters["dead_time_1_s"]
    assert abs(q.value - 0.02) < max(4 * q.error, 5e-4)
    assert late.improved.provenance.parent_sha256 == late.plant.sha256()
    assert "dead_time" in late.improved.effects
    assert_no_worse_held_out(late)


def test_no_other_effect_is_named_to_fit_the_phase_of_a_dead_time(plant, hidden, diagnosed):
    trials = hidden(dead_time_1_s=0.03, dead_time_phase_1=-0.9)
    diagnosis = diagnosed(plant, trials, ("dead_time", "sensor_lag", "viscous_friction"))
    assert diagnosis.named == ("dead_time",)
    assert diagnosis.improved.parameters["dead_time_1_s"].value == pytest.approx(0.03, abs=5e-4)
    assert diagnosis.improved.parameters["dead_time_phase_1"].value == pytest.approx(-0.9, abs=0.02)


def test_the_improved_plant_is_read_and_simulates_the_trials(late, tmp_path):
    """Its angle is off by the sensor's noise and what varies between trials: 2 ms of the clock."""
    late.improved.write(tmp_path / "plant.json")
    again = read_plant(tmp_path / "plant.json")
    before, after = (
        [c.error("angle_1_rad") for c in compare_with_trials(of, late.trials)]
        for of in (late.plant, again)
    )
    rate_rad_s = max(np.abs(np.gradient(t.goal_rad[:, 0], t.time_s)).max() for t in late.trials)
    assert np.std(before) > 5 * np.std(after)
    assert np.std(after) < 0.002 * rate_rad_s


def test_no_trial_of_an_improved_plant_or_its_parent_counts_as_unseen(late, trials_of, tmp_path):
    late.improved.write(tmp_path / "plant.json")
    provenance = read_plant(tmp_path / "plant.json").provenance
    of_parent = trials_of(read_plant(), 1)
    for fitted in (of_parent, late.trials):
        renamed = TrialSet((replace(fitted[0], name="another_name"),))
        with pytest.raises(InputError, match="another_name"):
            refuse_fitted(provenance, "plant.json", {"unseen_20deg": renamed})
    fresh = trials_of(read_plant(), 13, payloads=(0.5,), repeats=1)
    refuse_fitted(provenance, "plant.json", {"unseen_20deg": fresh})


def test_no_nested_model_costs_more(late):
    naming, base = late.naming, late.naming.search.nothing
    assert all(fit.gain > 0 for sets in naming.rounds for fit in sets)
    assert naming.fit.point.cost <= base.point.cost
    (alone,) = (f for f in naming.rounds[0] if f.candidates == ("dead_time",))
    assert alone.separation >= naming.search.screened["dead_time"]


def test_probabilities_add_up_and_hypotheses_share_them(late, nothing):
    for diagnosis in (late, nothing):
        answers = diagnosis.answers
        assert answers.nothing + answers.catalogue + answers.outside == pytest.approx(1)
        shares = sum(h.probability for h in diagnosis.hypotheses)
        assert shares == pytest.approx(answers.nothing + answers.catalogue, abs=0.02)


def test_unusable_arguments_are_refused(plant, hidden, make_trial):
    with pytest.raises(InputError, match=r"--without friction: .*choose from"):
        diagnose(plant, hidden(), leave_out=["friction"])
    mixed = TrialSet((make_trial(np.zeros((80, 1))), make_trial(np.zeros((80, 2)))))
    with pytest.raises(InputError, match="one and of two joints"):
        diagnose(plant, mixed)
    first, *others = hidden()
    with pytest.raises(InputError, match="is a copy of"):
        diagnose(plant, [first, replace(first, name="again"), *others])
    with pytest.raises(InputError, match=r"link_width_m is 0\.3, in the plant"):
        diagnose(plant, [with_conditions(first, link_width_m=0.3)])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("parameter", "change", "considered", "errors", "slack"),
    [
        ("viscous_friction_1_nm_s_rad", 4.0, (), 0, 0.8),
        ("position_gain_change_1", -0.2, GAINS, 3, 0.006),
        ("position_gain_change_1", 0.25, GAINS, 3, 0.0075),
        ("dead_time_1_s", 0.02, GAINS, 3, 0.0006),
        # Clocks of single trials would take up what exceeds 10 ms.
        ("sync_offset_s", 0.013, CLOCKS, 3, 0.0),
        ("sync_offset_s", -0.013, CLOCKS, 3, 0.0),
    ],
)
def test_one_effect_is_named_with_its_strength(
    plant, hidden, diagnosed, parameter, change, considered, errors, slack
):
    trials = hidden(**{parameter: change})
    diagnosis = diagnosed(plant, trials, considered) if considered else diagnosed(plant, trials)
    (name,) = diagnosis.named
    assert parameter.startswith(name) and not diagnosis.outliers
    if considered is GAINS:
        assert diagnosis.verdict == "closed"
    before = plant.parameters.get(parameter)
    after = diagnosis.improved.parameters[parameter]
    measured = after.value - (before.value if before else 0.0)
    assert abs(measured - change) <= errors * after.error + slack


@pytest.mark.slow
def test_a_lagged_current_is_named_and_not_the_friction_that_it_resembles(plant, hidden, diagnosed):
    """A lag takes the saw-tooth of the current's jumps away, which friction changes too."""
    considered = ("sensor_lag", "viscous_friction", "dead_time")
    diagnosis = diagnosed(plant, hidden(sensor_lag_1_s=0.02), considered)
    assert diagnosis.named[:1] == ("sensor_lag",)
    q = diagnosis.improved.parameters["sensor_lag_1_s"]
    assert abs(q.value - 0.02) < 3 * q.error + 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("tail", [0.02, 1.0], ids=["gaussian", "rational"])
def test_stribeck_friction_is_named_by_whichever_law_it_fades(plant, hidden, diagnosed, tail):
    considered = ("coulomb_friction", "stiction", "stribeck_friction", "viscous_friction")
    values = {
        "stribeck_friction_1_nm": 4.0,
        "stribeck_speed_1_rad_s": 0.06,
        "stribeck_tail_1": tail,
    }
    full = plant.with_effects("stribeck_friction").parameters
    trials = hidden(**{name: value - full[name].value for name, value in values.items()})
    diagnosis = diagnosed(plant, trials, considered)
    assert diagnosis.named == ("stribeck_friction",) and diagnosis.verdict == "closed"
    known = diagnosis.improved.parameters
    assert known["stribeck_friction_1_nm"].value == pytest.approx(4.0, rel=0.1)
    assert known["stribeck_speed_1_rad_s"].value == pytest.approx(0.06, rel=0.15)
    assert known["stribeck_tail_1"].value == pytest.approx(tail, abs=0.25)


@pytest.mark.slow
@pytest.mark.parametrize("mount", [1.0, 0.0], ids=["mount", "gear"])
def test_play_in_the_mount_is_distinguished_from_play_in_the_gear(plant, hidden, diagnosed, mount):
    trials = hidden(backlash_1_rad=0.008, backlash_mount_fraction=mount)
    diagnosis = diagnosed(plant, trials, dead_zones=True)
    assert diagnosis.named == ("backlash",) and diagnosis.verdict == "closed"
    known = diagnosis.improved.parameters
    assert known["backlash_1_rad"].value == pytest.approx(0.008, rel=0.1)
    assert known["backlash_mount_fraction"].value == pytest.approx(mount, abs=0.2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fraction", "tolerance"), [(0.9, 0.05), (0.7, 0.03)], ids=["just reached", "the arm falls"]
)
def test_a_current_limit_is_named_and_rows_after_a_fall_are_not_used(
    plant, hidden, diagnosed, fraction, tolerance
):
    wanted_a = fraction * max(np.abs(t.current_a).max() for t in hidden())
    limit_a = plant.parameters["current_limit_1_a"].value
    trials = hidden(current_saturation_1_a=limit_a - wanted_a)
    diagnosis = diagnosed(plant, trials, dead_zones=True)
    if fraction == 0.7:
        unused = diagnosis.nuisance.measured.residuals.goal_not_followed()
        assert set(unused) == {"payload1_1", "payload1_2"}
    assert diagnosis.named[:1] == ("current_saturation",)
    cut = diagnosis.improved.parameters["current_saturation_1_a"]
    assert limit_a - cut.value == pytest.approx(wanted_a, rel=tolerance)


@pytest.mark.slow
def test_friction_is_named_beside_a_dead_time(plant, hidden, diagnosed):
    trials = hidden(dead_time_1_s=0.05, coulomb_friction_1_nm=6.0)
    considered = ("dead_time", "coulomb_friction", "viscous_friction", "creep")
    diagnosis = diagnosed(plant, trials, considered)
    assert diagnosis.named == ("dead_time", "coulomb_friction")
    larger = diagnosis.improved.parameters["coulomb_friction_1_nm"].value
    assert larger == pytest.approx(plant.parameters["coulomb_friction_1_nm"].value + 6.0, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "same_link"),
    [
        ({"link_mass_kg": 0.06, "root_stiffness_1_nm_rad": 40.0, "root_damping_1_nm_s_rad": 0.3},
         False),
        ({"link_mass_kg": 0.03, "root_stiffness_1_nm_rad": 12.0}, True),
        # A motion capture that was set up anew.
        ({"marker_frame_roll_rad": 0.003, "marker_frame_tilt_rad": 0.0005,
          "marker_frame_yaw_rad": -0.003}, False),
    ],
    ids=["other link", "same link", "turned frame"],
)  # fmt: skip
def test_nuisance_is_refitted_and_never_called_missing(
    plant, hidden, diagnosed, changes, same_link
):
    settings = GapSettings(same_link=same_link)
    diagnosis = diagnosed(plant, hidden(**changes), settings=settings)
    assert diagnosis.verdict == "no gap" and not diagnosis.named
    before, after = (
        p.parameters["root_stiffness_1_nm_rad"].value for p in (plant, diagnosis.improved)
    )
    if same_link:
        assert diagnosis.improved.parameters == plant.parameters, "the same link did not change"
    elif "link_mass_kg" in changes:
        assert after - before == pytest.approx(40.0, rel=0.3)
        assert diagnosis.unexplained_fraction < 0.9


@pytest.mark.slow
def test_an_effect_outside_the_catalogue_is_reported_and_no_stand_in_is_written(
    plant, hidden, diagnosed
):
    """The encoder's ripple is not in this catalogue."""
    diagnosis = diagnosed(plant, hidden(encoder_ripple_1_rad=0.004))
    assert diagnosis.verdict == "not in the catalogue"
    assert diagnosis.answers.catalogue < 0.5
    assert diagnosis.improved.parameters == plant.parameters


@pytest.mark.slow
def test_an_effect_is_named_although_its_plant_is_worse_held_out(
    plant, hidden, diagnosed, monkeypatch
):
    """The check decides on the plant alone: here it refuses every fit with an effect."""
    monkeypatch.setattr(PlantWriter, "_failure", lambda _, fit: "worse" if fit.candidates else "")
    diagnosis = diagnosed(plant, hidden(dead_time_1_s=0.02))
    assert diagnosis.named == ("dead_time",) and diagnosis.verdict == "closed"
    assert diagnosis.written.candidates == () and diagnosis.written.refused == "worse"
    assert "dead_time" not in diagnosis.improved.effects
    assert "dead_time" in diagnosis.fitted.effects


def test_a_refusal_is_told_only_if_a_named_effect_is_not_written(late, monkeypatch):
    """The first of two fits with the effect is refused here, the second is written."""
    refusals = iter(["worse", ""])
    monkeypatch.setattr(PlantWriter, "_failure", lambda *_: next(refusals))
    written = PlantWriter(late.naming.search, 0.05).best(late.naming.fit)
    assert (written.candidates, written.refused) == (("dead_time",), "")


@pytest.mark.parametrize("same_link", [False, True])
def test_a_link_that_is_the_same_is_written_as_it_was(late, monkeypatch, same_link):
    """Every refitted link is better here."""
    monkeypatch.setattr(PlantWriter, "_is_earned", lambda *_: True)
    search = late.naming.search
    for fit in (late.naming.fit, search.nothing):
        written = PlantWriter(search, 1.0, same_link).best(fit)
        improved = improved_plant(late.plant, search, written, late.trials).parameters
        name = "root_stiffness_1_nm_rad"
        assert (improved[name].value == late.plant.parameters[name].value) is same_link


# Outlier trials


def bumped(trial):
    """A trial in which somebody pushed the arm for a third of a second."""
    push = np.zeros(len(trial))
    push[150:170] = np.hanning(20)
    sizes = {"angle_1_rad": 0.02, "current_1_a": 4.0, "tip_x_m": 0.1}
    pushed = {name: trial.columns[name] + size * push for name, size in sizes.items()}
    return with_columns(trial, **pushed)


def mislabelled(trial):
    """A trial with 1 kg whose description states none."""
    return with_conditions(trial, payload_kg=0.0, trial=3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "hidden_effect", "named"),
    [
        (bumped, {}, ()),
        (mislabelled, {}, ()),
        (bumped, {"viscous_friction_1_nm_s_rad": 4.0}, ("viscous_friction",)),
    ],
    ids=["bumped", "mislabelled", "bumped, with an effect"],
)
def test_an_outlier_is_excluded_and_reported(
    plant, hidden, diagnosed, change, hidden_effect, named
):
    *others, last = hidden(**hidden_effect)
    diagnosis = diagnosed(plant, TrialSet((*others, change(last))), FEW)
    assert [o.name for o in diagnosis.outliers] == [last.name]
    assert diagnosis.named == named
    if not named:
        assert diagnosis.verdict == "no gap"
    document = gap_document(diagnosis)
    assert [o.name for o in document.odd_trials] == [last.name]
    assert last.name in gap_in_words(document)


@pytest.mark.slow
def test_scatter_of_repetitions_raises_the_floor_at_that_payload(plant, hidden, diagnosed):
    """The tip sways slowly with 1 kg, mostly in opposite directions in two repetitions."""
    trials = []
    for trial in hidden():
        sway = np.sin(2 * np.pi * 0.6 * trial.columns["time_s"] + 1.0)
        size_m = 0.001 + (0.004 if trial.meta.trial == 1 else -0.004)
        moved = {
            name: trial.columns[name] + trial.meta.payload_kg * size_m * sway
            for name in ("tip_x_m", "tip_z_m")
        }
        trials.append(with_columns(trial, **moved))
    diagnosis = diagnosed(plant, TrialSet(tuple(trials)), FEW)
    assert set(diagnosis.floor.amplification_power) == {1.0}
    assert (diagnosis.named, diagnosis.verdict) == ((), "no gap")


# Two joints

FRICTION_NM_S_RAD = 4.0


@pytest.fixture(scope="module")
def two_joints(trials_of):
    """Plant with the floor of its own trials of one and of two joints."""
    nominal = read_plant()
    one, two = (trials_of(nominal, 1, dof=dof).trials for dof in (1, 2))
    return with_noise_floor(nominal, [*one, *two])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("joints", "named", "verdict"),
    [
        ((), (), "no gap"),
        ((1, 2), ("viscous_friction",), "closed"),
        ((2,), ("viscous_friction:2",), "closed"),
    ],
    ids=["nothing", "both", "second alone"],
)
def test_friction_is_named_in_the_joints_that_have_it(
    two_joints, trials_of, diagnosed, joints, named, verdict
):
    friction = {j: f"viscous_friction_{j}_nm_s_rad" for j in (1, 2)}
    before = {j: two_joints.parameters[name].value for j, name in friction.items()}
    rough = two_joints.with_values({friction[j]: before[j] + FRICTION_NM_S_RAD for j in joints})
    diagnosis = diagnosed(two_joints, trials_of(rough, 7, (1.0,), dof=2))
    assert (diagnosis.verdict, diagnosis.named) == (verdict, named)
    for j, name in friction.items():
        change = diagnosis.improved.parameters[name].value - before[j]
        if j in joints:
            assert change == pytest.approx(FRICTION_NM_S_RAD, rel=0.1)
        elif joints:
            assert abs(change) < 0.3
