"""What a person checks on the robot: one sentence for each effect, likely ones first."""

from models.gap.report.effect_checks import (
    EFFECT_CHECKS,
    GENERAL_CHECK,
    MOST_CHECKS,
    effects_to_check,
)
from models.gap.report.gap_json import RefusedEffects
from models.shared.catalogue import EVERY_EFFECT


def test_every_effect_has_one_check():
    assert EFFECT_CHECKS.keys() == EVERY_EFFECT.keys()
    assert len(set(EFFECT_CHECKS.values())) == len(EFFECT_CHECKS)


def test_named_effects_come_first_then_likely_ones_then_look_alikes(document, effect):
    found = document(
        "closed", effect("creep", look_alikes=["encoder_offset"]), effect("prebend", 2),
        effect_probabilities={"creep": 0.9, "cogging:1": 0.4, "hysteresis": 0.3, "stiction": 0.09},
    )  # fmt: skip
    order = ["creep", "prebend", "cogging", "hysteresis", "encoder_offset"]
    assert list(effects_to_check(found)) == order


def test_an_own_effect_has_a_general_check_and_the_list_is_short(document, effect):
    assert effects_to_check(document("closed", effect("hose_spring"))) == {
        "hose_spring": GENERAL_CHECK
    }
    many = document(effect_probabilities=dict.fromkeys(EVERY_EFFECT, 0.5))
    assert len(effects_to_check(many)) == MOST_CHECKS
    assert effects_to_check(document()) == {}


def test_what_may_be_missing_beside_the_named_effects_is_checked_where_a_gap_is_left(
    document, effect
):
    further = RefusedEffects(("unmodelled_payload",), "further", 17.0, "equations")
    for verdict, checked in (("reduced", True), ("closed", False)):
        found = document(verdict, effect("backlash"), refused=(further,))
        assert ("unmodelled_payload" in effects_to_check(found)) == checked
