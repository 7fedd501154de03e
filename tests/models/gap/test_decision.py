"""The decision: probabilities, look-alikes, outlier trials, and what is written to the plant."""

from dataclasses import replace
from types import SimpleNamespace
from typing import get_args

import msgspec
import numpy as np
import pytest

from models.gap.decision.certainty import Answers, Evidence, Knowledge, read_certainty
from models.gap.decision.look_alikes import effect_probabilities, hypotheses_of, look_alikes_of
from models.gap.decision.naming import Naming
from models.gap.estimation.gauss_newton import FitPoint
from models.gap.estimation.noise_floor import NoiseFloor
from models.gap.improved_plant import _standard_errors
from models.gap.outliers import outlier_trials
from models.gap.report.gap_results import gap_document
from models.gap.search.effect_search import SetFit
from models.plant.identification.residual_spectra import FitParameter
from models.plant.identification.trial_spectra import TrialGroup
from models.plant.plant import read_plant
from models.plant.simulation.runner import CompiledModel, run_trial
from models.plant.step_model import names
from models.trials.trial import Trial, TrialMeta, TrialSet
from tests.models.gap.conftest import assert_no_worse_held_out


@pytest.mark.parametrize(
    ("evidence", "answer"),
    [
        (Evidence(60.0, difference=0.05, residual=1.0), "catalogue"),
        (Evidence(2.0, difference=0.2, residual=0.9), "nothing"),
        (Evidence(6.0, difference=0.5, residual=1.0), "nothing"),
        (Evidence(40.0, difference=0.8, residual=2.0), "outside"),
    ],
    ids=["clear", "faint", "the plant's error", "stand-in"],
)
def test_the_most_probable_answer_follows_the_evidence(evidence, answer):
    answers = msgspec.structs.asdict(read_certainty().answers_for(evidence, "identified"))
    assert sum(answers.values()) == pytest.approx(1.0)
    assert max(answers, key=answers.get) == answer


@pytest.mark.parametrize(
    ("less", "more"),
    [
        (Evidence(15.0, 0.1, 1.2), Evidence(40.0, 0.1, 1.2)),
        (Evidence(15.0, 0.4, 1.2), Evidence(15.0, 0.1, 1.2)),
        (Evidence(15.0, 0.1, 5.0), Evidence(15.0, 0.1, 1.2)),
    ],
    ids=["a larger separation", "strengths that differ less", "less that is unexplained"],
)
def test_evidence_that_speaks_for_a_name_makes_it_more_probable(less, more):
    first, second = (read_certainty().answers_for(e, "identified") for e in (less, more))
    assert first.catalogue < second.catalogue


@pytest.mark.parametrize("knowledge", get_args(Knowledge))
def test_far_more_than_is_left_without_an_effect_is_not_called_no_gap(knowledge):
    """A stand-in with a d′ that nothing reaches too leaves four times what nothing leaves."""
    certainty = read_certainty()
    separation = certainty.separation_of_nothing[knowledge]
    residual = 4 * certainty.residual_of_nothing[knowledge]
    answers = certainty.answers_for(Evidence(separation, 0.5, residual), knowledge)
    assert answers.outside > answers.nothing


def test_an_effect_without_an_entry_is_treated_with_the_most_caution():
    certainty = read_certainty()
    known = [certainty.error_of_strength(name) for name in certainty.equation_error]
    assert certainty.error_of_strength("an effect that was added since") >= max(known)


# Look-alikes and hypotheses

CATALOGUE = Answers(0.0, 1.0, 0.0)


def naming(named=(), answers=CATALOGUE, **separations):
    """Result of a search with these d′ of its sets; names of a pair are joined by "__"."""
    search = SimpleNamespace(of=dict.fromkeys(range(32)), nothing=set_fit((), 0.0))
    sets = [set_fit(tuple(name.split("__")), d) for name, d in separations.items()]
    fit = next((f for f in sets if f.candidates == named), search.nothing)
    return Naming(fit, fit, (tuple(sets),), search, None, answers)


def set_fit(candidates, separation):
    return SetFit(candidates, None, np.zeros(1, dtype=bool), separation**2 / 2)


def probabilities(named, answers=CATALOGUE, **separations):
    return {h.effects: h.probability for h in hypotheses_of(naming(named, answers, **separations))}


@pytest.mark.parametrize(
    ("separations", "alike"),
    [
        ((40.0, 15.0), ()),
        ((8.0, 8.0), ("hysteresis",)),
        # The same difference of squares counts less beside a larger gap.
        ((np.hypot(10.0, 6.0), 10.0), ()),
        ((np.hypot(40.0, 6.0), 40.0), ("hysteresis",)),
    ],
)
def test_a_candidate_that_fits_nearly_as_well_is_a_look_alike(separations, alike):
    sets = dict(zip(("creep", "hysteresis"), separations, strict=True))
    rows = look_alikes_of(naming(("creep",), **sets))["creep"]
    assert tuple(f.candidates[0] for f in rows) == alike


def test_a_look_alike_stands_beside_the_same_other_names():
    sets = {"backlash__creep": 50.0, "backlash__hysteresis": 49.8, "creep__hysteresis": 20.0}
    rows = look_alikes_of(naming(("backlash", "creep"), backlash=40.0, **sets))
    assert rows["backlash"] == ()
    assert [f.candidates for f in rows["creep"]] == [("backlash", "hysteresis")]


def test_a_large_gap_separates_no_better_than_its_equation_allows():
    """By noise alone a difference of d′ = 10 would put the second below 1e-14."""
    rows = probabilities(("creep",), creep=100.0, hysteresis=99.5)
    assert rows["hysteresis",] > 0.01
    assert probabilities(("creep",), creep=100.0, hysteresis=80.0)["creep",] > 0.97


def test_a_difference_of_three_by_noise_counts_twenty_to_one():
    rows = probabilities(("creep",), creep=np.hypot(8.0, 3.0), hysteresis=8.0)
    assert rows["creep",] / rows["hysteresis",] == pytest.approx(np.exp(3.0))


def test_useless_effects_beside_the_right_one_do_not_outweigh_it():
    """Every pair with the right effect fits as well; one more effect is as improbable as many."""
    sets = {"softening": 70.0} | {f"softening__other_{k}": 70.0 for k in range(29)}
    hypotheses = hypotheses_of(naming(("softening",), **sets))
    assert hypotheses[0].effects == ("softening",) and hypotheses[0].probability > 0.4
    by_effect = effect_probabilities(hypotheses)
    assert by_effect.pop("softening") == pytest.approx(1.0, abs=0.03)
    assert max(by_effect.values(), default=0.0) < 0.05


def test_a_part_of_the_names_is_no_hypothesis():
    """The answer holds for all of them."""
    rows = probabilities(
        ("creep", "backlash"), Answers(0.1, 0.8, 0.1), creep=40.0, creep__backlash=42.0
    )
    assert rows == pytest.approx({("creep", "backlash"): 0.8, (): 0.1})


# Outlier trials


@pytest.mark.parametrize(
    ("payloads_kg", "levels", "outliers"),
    [
        ((0.0, 0.0, 1.0, 1.0), (1.0, 1.2, 1.1, 2.5), [3]),
        ((0.0, 0.0, 1.0, 1.0), (1.0, 1.2, 4.0, 7.0), []),
        ((0.0, 1.0, 2.0, 0.5), (1.0, 1.2, 1.1, 2.5), []),
        ((0.0, 1.0, 2.0, 0.5), (1.0, 1.2, 1.1, 4.0), [3]),
        ((0.0, 1.0, 2.0, 2.5), (1.0, 1.2, 1.1, 9.0), []),
    ],
)
def test_an_outlier_differs_from_its_repetition_or_else_from_lighter_and_heavier_trials(
    make_trial, payloads_kg, levels, outliers
):
    """Levels in noise floors, whose deviation is 2."""
    trials = [
        make_trial(np.zeros(200), payload_kg=kg, name=str(k)) for k, kg in enumerate(payloads_kg)
    ]
    group = TrialGroup("motion", tuple(range(len(trials))), ("x",), 50)
    rows = 2.0 * np.array(levels)[:, None, None] * np.ones((1, 1, 50))
    floor = NoiseFloor(np.array([0.0, 30.0]), {"x": np.full(2, 4.0)}, {"x": np.zeros(2)})
    estimator = SimpleNamespace(
        residuals=SimpleNamespace(trials=trials, groups=[group]),
        means=[np.zeros_like(rows)], floor=floor,
    )  # fmt: skip
    result = outlier_trials(estimator, SimpleNamespace(rows=[rows]))
    assert [int(o.name) for o in result] == outliers
    assert [o.floors for o in result] == pytest.approx([levels[k] for k in outliers])


# What is written. The trials of a pendulum cost milliseconds; its servo reports no current.

FRICTION_NM = 0.05


@pytest.fixture(scope="module")
def pendulum():
    """Pendulum with viscous friction alone."""
    return read_plant("models/plant/examples/xl330_pendulum.toml")


def swings(pendulum, frictions_nm):
    """Trials of each payload with the friction that belongs to it: {payload in kg: N·m}."""
    rng = np.random.default_rng(5)
    time_s = 0.005 * np.arange(400)
    trials = []
    for payload_kg, friction_nm in frictions_nm.items():
        changes = {"coulomb_friction_1_nm": friction_nm}
        rough = pendulum.with_effects("coulomb_friction").with_values(changes)
        compiled = CompiledModel(rough.step_model(1, "twin"))
        angle = names(compiled.model.outputs).index("angle_1_rad")
        for period_s in (2.0, 1.3):
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
            columns["angle_1_rad"] = y[:, angle] + 1e-3 * rng.standard_normal(len(y))
            trials.append(Trial(name, meta, columns))
    return TrialSet(tuple(trials))


@pytest.fixture(scope="module")
def diagnosis(pendulum, diagnosed):
    """Function (frictions by payload, highest friction) -> diagnosis over Coulomb friction."""

    def run(frictions_nm, high_nm=None):
        bounded = pendulum
        if high_nm is not None:
            known = pendulum.expected["coulomb_friction_1_nm"]
            tight = {known.name: msgspec.structs.replace(known, high=high_nm)}
            bounded = replace(pendulum, expected=pendulum.expected | tight)
        return diagnosed(bounded, swings(pendulum, frictions_nm), ("coulomb_friction",))

    return run


def test_an_effect_that_all_payloads_show_is_named_and_lowers_the_held_out_error(diagnosis):
    result = diagnosis({0.0: FRICTION_NM, 0.2: FRICTION_NM})
    assert result.named == result.written.candidates == ("coulomb_friction",)
    assert result.verdict == "no floor", "no trial was repeated"
    assert result.left_out == ("payloads", "motions")
    assert result.unexplained_fraction < 0.5
    assert result.gap_left_fraction is None, "noise and gap cannot be told apart"
    q = result.improved.parameters["coulomb_friction_1_nm"]
    assert q.value == pytest.approx(FRICTION_NM, rel=0.2)
    assert_no_worse_held_out(result)


def test_without_a_floor_other_effects_have_a_separation_and_none_a_probability(
    pendulum, diagnosed
):
    trials = swings(pendulum, {0.0: FRICTION_NM, 0.2: FRICTION_NM})
    result = diagnosed(pendulum, trials, ("coulomb_friction", "stribeck_friction"))
    document = gap_document(result)
    (other,) = [row for row in document.rejected if row.effect == "stribeck_friction"]
    assert 0.0 < other.separation < document.named[0].evidence.separation
    assert document.effect_probabilities == {}


@pytest.mark.parametrize(
    ("frictions_nm", "high_nm"),
    [({0.0: 0.0, 0.2: FRICTION_NM}, None), ({0.0: FRICTION_NM, 0.2: FRICTION_NM}, FRICTION_NM / 3)],
    ids=["one payload shows it", "at its bound"],
)
def test_without_a_floor_a_doubtful_effect_is_neither_named_nor_written(
    diagnosis, frictions_nm, high_nm
):
    result = diagnosis(frictions_nm, high_nm)
    assert result.named == ()
    assert result.improved.effects == result.plant.effects
    if high_nm is None:
        assert result.improved.parameters == result.plant.parameters
    assert_no_worse_held_out(result)


@pytest.mark.parametrize(("correlation", "chance_s"), [(-1.0, 0.0), (0.0, 0.01 * 2**0.5)])
def test_the_standard_error_of_a_sum_is_not_that_of_its_parts(correlation, chance_s):
    """Trials determine the sum: each part may be as uncertain as its prior."""
    moved = {"sync_offset_s": 1.0}
    parameters = [
        FitParameter("synchronisation", "nuisance", moved),
        FitParameter("sync_offset_s", "effect", moved, effect="sync_offset"),
    ]
    estimator = SimpleNamespace(
        residuals=SimpleNamespace(fit_parameters=parameters),
        covariance=lambda point, free: 1e-4 * np.array([[1, correlation], [correlation, 1]]),
        mean_square=lambda point: 1.0,
    )
    point = FitPoint(np.array([0.01, 0.02]), 0.0, [])
    full = SimpleNamespace(parameters={"sync_offset_s": None})
    errors = _standard_errors(full, estimator, point, np.ones(2, dtype=bool))
    missed_s = 0.02 * read_certainty().error_of_strength("sync_offset")
    assert errors == {"sync_offset_s": pytest.approx(np.hypot(chance_s, missed_s))}
