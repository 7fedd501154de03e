"""Null distribution: the less is known of the plant's own error, the larger d′ must be."""

from types import SimpleNamespace

import pytest

from models.gap.search.null_distribution import (
    KEY_ENDS,
    known_error,
    null_distribution_of,
    null_distributions,
)
from models.plant.plant import read_plant

EFFECTS = sorted(null_distributions()["1"].standard_deviation)


@pytest.mark.parametrize("dof", [1, 2])
@pytest.mark.parametrize("change", [0.3, 1.0])
def test_on_other_motions_no_effect_needs_less(dof, change):
    plant = read_plant()
    curves, nothing = (
        null_distribution_of(plant, dof, known).for_link_change(change)
        for known in ("curves", "nothing")
    )
    assert all(nothing.least([e]) >= curves.least([e]) for e in EFFECTS)
    assert nothing.least(["stribeck_friction"]) > 3 * curves.least(["stribeck_friction"])


@pytest.mark.parametrize(
    ("knowledge", "known"),
    [
        ({"a": ("unknown", "unknown")}, "nothing"),
        ({"a": ("unknown", "unknown"), "b": ("measured", "unknown")}, "curves"),
        ({"a": ("transferred", "unknown")}, "curves"),
        ({"a": ("unknown", "measured")}, "patterns"),
        ({"a": ("measured", "unknown"), "b": ("measured", "transferred")}, "patterns"),
    ],
)
def test_what_is_known_of_any_motion_counts(knowledge, known):
    assert known_error(SimpleNamespace(knowledge=lambda: knowledge)) == known
    assert known in KEY_ENDS
