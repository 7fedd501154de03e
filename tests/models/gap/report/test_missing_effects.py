"""Effects that are named, and taken out again, on the page of a diagnosis."""

from types import SimpleNamespace

import pytest

from models.gap.report.gap_json import SeparatingMotion
from models.gap.report.missing_effects import compared_effects, named_effects
from models.gap.settings import DEFAULT_SETTINGS


def named(effect, kept, separation=15.0):
    evidence = SimpleNamespace(
        separation=separation, least=9.0, strength_holds=True, strength_standard_deviation=0.06
    )
    return SimpleNamespace(
        effect=effect, kept=kept, evidence=evidence, parameters={}, look_alikes=[],
        separated_by=None,
    )  # fmt: skip


def rejected(effect, separation):
    return SimpleNamespace(effect=effect, separation=separation, least=9.0)


def test_an_effect_that_was_taken_out_is_not_in_the_table_of_those_named():
    found = SimpleNamespace(
        named=[named("creep", True), named("backlash", False)], settings=DEFAULT_SETTINGS
    )
    kept, taken_out = named_effects(found, None)
    assert "creep" in kept.rows[0][0] and len(kept.rows) == 1
    assert "backlash" in taken_out.rows[0][0] and "taken out" in taken_out.title
    found.named = [named("creep", False)]
    nothing, _ = named_effects(found, None)
    assert nothing.text


def test_what_was_hidden_in_one_joint_is_told_with_the_joint():
    found = SimpleNamespace(
        named=[named("backlash", True), named("creep", True)], settings=DEFAULT_SETTINGS
    )
    table, *_ = named_effects(found, {"backlash:2": 0.01, "creep": 0.3})
    assert [row[1] for row in table.rows] == ["0.01 rad, joint 2", "0.3"]


@pytest.mark.parametrize(("separation", "words"), [(2.65, "no fixed motion"), (4.8, "'multisine'")])
def test_a_motion_is_told_only_where_it_tells_look_alikes_apart(separation, words):
    row = named("encoder_offset", True)
    row.look_alikes = [SimpleNamespace(effect="prebend")]
    row.separated_by = SeparatingMotion("multisine", {"multisine": separation, "triangle": 1.5})
    table, *_ = named_effects(SimpleNamespace(named=[row], settings=DEFAULT_SETTINGS), None)
    assert words in table.rows[0][-1]


@pytest.mark.parametrize("kept", [True, False])
def test_each_effect_is_compared_once(kept):
    rows = [rejected("creep", 12.0), *(rejected(f"other_{k}", 11.0 - k) for k in range(9))]
    found = SimpleNamespace(named=[named("creep", kept)], rejected=rows)
    (figure,) = compared_effects(found)
    (panel,) = figure.panels
    assert panel.alt.count("creep") == 1
    assert "creep 1.7, other 0 1.2," in panel.alt
    assert panel.alt.count(",") == 7
