"""Stribeck friction in the effect search: its strength is found by whichever law it fades."""

from dataclasses import replace

import pytest

from models.gap.diagnosis import diagnose
from models.gap.estimation.fitted_floor import noise_floor_for
from models.gap.estimation.gauss_newton import GaussNewton
from models.gap.estimation.nuisance_fit import NuisanceFit
from models.gap.residuals.fit_parameters import (
    all_fit_parameters,
    candidate_effects,
    effect_candidates,
)
from models.gap.residuals.residuals import Residuals
from models.gap.search.effect_search import EffectSearch
from models.plant.document import Provenance
from models.plant.effects import EFFECTS

CONSIDERED = ("coulomb_friction", "stiction", "stribeck_friction", "viscous_friction")


@pytest.mark.slow
@pytest.mark.parametrize("tail", [0.02, 1.0], ids=["gaussian", "rational"])
def test_strength_and_tail_are_found_whichever_way_it_fades(plant, hidden, tail):
    strength_nm, speed_rad_s = 4.0, 0.06
    full = plant.with_effects("stribeck_friction").parameters
    values = {
        "stribeck_friction_1_nm": strength_nm,
        "stribeck_speed_1_rad_s": speed_rad_s,
        "stribeck_tail_1": tail,
    }
    trials = hidden(**{name: value - full[name].value for name, value in values.items()})
    others = [e for e in candidate_effects(plant) if e not in CONSIDERED]
    found = diagnose(plant, trials, leave_out=others)
    assert found.named == ("stribeck_friction",) and found.verdict == "closed"
    known = found.improved.parameters
    assert known["stribeck_friction_1_nm"].value == pytest.approx(strength_nm, rel=0.1)
    assert known["stribeck_speed_1_rad_s"].value == pytest.approx(speed_rad_s, rel=0.15)
    assert known["stribeck_tail_1"].value == pytest.approx(tail, abs=0.25)


def test_what_is_fitted_last_is_no_strength(plant):
    late = {
        q.name: q.effect
        for name in candidate_effects(plant)
        for q in effect_candidates(plant, name, 1)[name]
        if q.fitted_last
    }
    assert late == {"stribeck_tail_1": "stribeck_friction"}
    for parameter, effect in late.items():
        assert parameter not in plant.with_effects(effect).strengths(effect, 1)
        assert set(EFFECTS[effect].fitted_last) <= {q.name for q in EFFECTS[effect].per_joint}


@pytest.mark.parametrize("learned", [True, False])
def test_the_tail_is_fitted_only_where_the_noise_floor_is_learned(plant, hidden, learned):
    given = plant if learned else replace(plant, provenance=Provenance())
    trials, effect = hidden(stribeck_friction_1_nm=4.0).trials, "stribeck_friction"
    residuals = Residuals(given, trials, all_fit_parameters(given, trials, [effect]))
    estimator = GaussNewton(residuals, noise_floor_for(residuals))
    search = EffectSearch(NuisanceFit(estimator, estimator, estimator.start()))
    fitted = [
        q.name for q, own in zip(residuals.fit_parameters, search.of[effect], strict=True) if own
    ]
    assert estimator.floor.learned is learned
    assert ("stribeck_tail_1" in fitted) is learned
    assert {"stribeck_friction_1_nm", "stribeck_speed_1_rad_s"} <= set(fitted)
