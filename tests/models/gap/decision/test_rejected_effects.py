"""Effects that were not named: each has one reason."""

import numpy as np

from models.gap.decision.rejected_effects import UNEXCITED, rejected_effects
from models.gap.estimation.gauss_newton import FitPoint
from models.gap.search.candidate import SearchResult
from models.gap.search.null_distribution import NullDistribution
from models.gap.search.refused_effect import RefusedEffect

START = FitPoint(np.zeros(1), 0.0, [])
NULL = NullDistribution(threshold=5.0, explained=1.6)


def reasons(screened, unexcited=(), refused=()):
    rows = [
        RefusedEffect(
            effect=e, kind="at a bound", reason="at its bound", name="", value=0, limit=0, unit="1"
        )
        for e in refused
    ]
    result = SearchResult(START, START, unexcited=list(unexcited), refused=rows)
    result.screened.update(screened)
    return {row.effect: row.reason for row in rejected_effects(result, NULL)}


def test_a_dead_zone_that_a_large_strength_leaves_is_no_effect_that_is_not_excited():
    screened = {"backlash": 8.0, "current_saturation": 0.2, "creep": 3.0}
    found = reasons(screened, ("backlash", "current_saturation", "cross_axis_coupling"))
    assert {e for e, reason in found.items() if reason == UNEXCITED} == {
        "current_saturation", "cross_axis_coupling",
    }  # fmt: skip
    assert found["backlash"] == found["creep"]


def test_a_refused_pair_tells_nothing_of_its_effects_alone():
    screened = {"dead_time": 8.0, "cogging": 3.0}
    pair, both = reasons(screened, refused=["dead_time + cogging"]), reasons(screened)
    assert "bound" not in pair["dead_time"] + pair["cogging"]
    assert pair["cogging"] == both["cogging"]
    assert "at its bound" in reasons(screened, refused=["dead_time"])["dead_time"]
