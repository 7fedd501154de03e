"""Look-alikes and hypotheses: what the trials cannot tell apart."""

from types import SimpleNamespace

import numpy as np
import pytest

from models.gap.decision.certainty import Answers
from models.gap.decision.look_alikes import effect_probabilities, hypotheses_of, look_alikes_of
from models.gap.decision.naming import Naming
from models.gap.search.effect_search import SetFit

CATALOGUE = Answers(0.0, 1.0, 0.0)


def naming(named=(), answers=CATALOGUE, **separations):
    """Result of a search whose sets are given by their d′; names of a pair are joined by "__"."""
    search = SimpleNamespace(of=dict.fromkeys(range(32)), nothing=set_fit((), 0.0))
    sets = [set_fit(tuple(name.split("__")), d) for name, d in separations.items()]
    fit = next((f for f in sets if f.candidates == named), search.nothing)
    return Naming(fit, fit, (tuple(sets),), search, None, answers)


def set_fit(candidates, separation):
    return SetFit(candidates, None, np.zeros(1, dtype=bool), separation**2 / 2)


def alike(name, **separations):
    return [f.candidates[0] for f in look_alikes_of(naming((name,), **separations))[name]]


def test_a_candidate_far_ahead_has_none():
    assert alike("creep", creep=40.0, hysteresis=15.0, backlash=5.0) == []


@pytest.mark.parametrize("separation", [8.0, 40.0, 150.0])
def test_equal_candidates_are_look_alikes_at_any_size(separation):
    assert alike("prebend", prebend=separation, encoder_offset=separation) == ["encoder_offset"]


def test_the_error_of_an_equation_grows_with_the_gap():
    """The same difference of squares counts less beside a larger gap."""
    small, large = np.hypot(10.0, 6.0), np.hypot(40.0, 6.0)
    assert alike("creep", creep=small, hysteresis=10.0) == []
    assert alike("creep", creep=large, hysteresis=40.0) == ["hysteresis"]


def test_a_look_alike_stands_beside_the_same_other_names():
    sets = {"backlash__creep": 50.0, "backlash__hysteresis": 49.8, "creep__hysteresis": 20.0}
    found = look_alikes_of(naming(("backlash", "creep"), backlash=40.0, **sets))
    assert found["backlash"] == ()
    assert [f.candidates for f in found["creep"]] == [("backlash", "hysteresis")]


def test_a_large_gap_separates_no_better_than_its_equation_allows():
    """By noise alone a difference of d′ = 10 would leave the second below 1e-14."""
    rows = probabilities(("creep",), creep=100.0, hysteresis=99.5)
    assert rows["hysteresis",] > 0.01
    assert probabilities(("creep",), creep=100.0, hysteresis=80.0)["creep",] > 0.97


def probabilities(named, answers=CATALOGUE, **separations):
    return {h.effects: h.probability for h in hypotheses_of(naming(named, answers, **separations))}


def test_useless_effects_beside_the_right_one_do_not_outweigh_it():
    """Every pair with the right effect fits as well; one more effect is as improbable as many."""
    sets = {"softening": 70.0} | {f"softening__other_{k}": 70.0 for k in range(29)}
    hypotheses = hypotheses_of(naming(("softening",), **sets))
    assert hypotheses[0].effects == ("softening",)
    assert hypotheses[0].probability > 0.4
    by_effect = effect_probabilities(hypotheses)
    assert by_effect["softening"] == pytest.approx(1.0, abs=0.03)
    assert max((p for e, p in by_effect.items() if e != "softening"), default=0.0) < 0.05


def test_a_part_of_the_names_is_no_hypothesis():
    """The answer holds for all of them."""
    rows = probabilities(
        ("creep", "backlash"), Answers(0.1, 0.8, 0.1), creep=40.0, creep__backlash=42.0
    )
    assert rows == pytest.approx({("creep", "backlash"): 0.8, (): 0.1})
