"""Null distribution: the less is known of the plant's own error, the larger d′ must be."""

from types import SimpleNamespace

import pytest

from models.gap.search.null_distribution import (
    KnownError,
    known_error,
    null_distribution_of,
    null_distributions,
)
from models.gap.settings import DEFAULT_SETTINGS
from models.plant.plant import read_plant

EFFECTS = sorted(null_distributions()["1"].standard_deviation)
KNOWN, NOTHING = KnownError(), KnownError(patterns=False, other_motions=1.0)
BETWEEN = KnownError(other_payloads=1.0)


@pytest.mark.parametrize("dof", [1, 2])
@pytest.mark.parametrize("change", [0.3, 1.0])
@pytest.mark.parametrize(
    ("less", "effect", "factor"),
    [(NOTHING, "stribeck_friction", 3.0), (BETWEEN, "encoder_ripple", 1.5)],
)
def test_where_less_is_known_no_effect_needs_less(dof, change, less, effect, factor):
    known, own = (
        null_distribution_of(read_plant(), dof, error).for_link_change(change)
        for error in (KnownError(less.patterns), less)
    )
    assert all(own.least([e]) >= known.least([e]) for e in EFFECTS)
    assert own.least([effect]) > factor * known.least([effect])


@pytest.mark.parametrize("error", [NOTHING, BETWEEN])
def test_a_part_of_the_trials_needs_a_part_of_it(error):
    half = KnownError(error.patterns, error.other_motions / 2, error.other_payloads / 2)
    least = [
        null_distribution_of(read_plant(), 1, own).for_link_change(0.5).least(["backlash"])
        for own in (KNOWN, half, error)
    ]
    assert least[0] < least[1] < least[2]


GROUPS = {"a": [0.0, 1.0, 2.0], "b": [0.5, 1.5, 1.0]}


@pytest.mark.parametrize(
    ("knowledge", "known"),
    [
        ({"a": ("unknown", "unknown")}, KnownError(False, 1.0, 0.0)),
        (
            {"a": ("unknown", "unknown"), "b": ("measured", "unknown")},
            KnownError(False, 0.5, 1 / 3),
        ),
        ({"a": ("transferred", "unknown")}, KnownError(False)),
        ({"a": ("measured", "measured")}, KnownError()),
        ({"b": ("measured", "transferred")}, KnownError(True, 0.0, 2 / 3)),
    ],
)
def test_motions_and_payloads_that_the_plant_was_not_identified_on_count(knowledge, known):
    kg = [payload_kg for name in knowledge for payload_kg in GROUPS[name]]
    groups = [
        SimpleNamespace(key=name, trials=range(3 * k, 3 * k + 3))
        for k, name in enumerate(knowledge)
    ]
    trials = [SimpleNamespace(meta=SimpleNamespace(payload_kg=own)) for own in kg]
    measured = {0.0: {}, 1.0: {}, 2.0: {}}
    found = known_error(
        SimpleNamespace(
            knowledge=lambda: knowledge, settings=DEFAULT_SETTINGS,
            residuals=SimpleNamespace(groups=groups, trials=trials),
            floor=SimpleNamespace(curves_for=lambda g, _: (measured, knowledge[g.key][0])),
        )
    )  # fmt: skip
    assert found.patterns == known.patterns
    assert found.other_motions == known.other_motions
    assert found.other_payloads == pytest.approx(known.other_payloads)
