"""What a person checks on the robot: one sentence for each effect, likely ones first."""

from types import SimpleNamespace

from models.gap.decision.further_effect import FurtherEffect
from models.gap.report.effect_checks import EFFECT_CHECKS, MOST_CHECKS, effects_to_check
from models.shared.catalogue import EVERY_EFFECT


def document(*named, probabilities=None, verdict="closed", further=None):
    return SimpleNamespace(
        verdict=verdict,
        tested=[SimpleNamespace(further=further)],
        named=[
            SimpleNamespace(
                kept=kept, effect=effect, look_alikes=[SimpleNamespace(effect=e) for e in alike]
            )
            for effect, kept, alike in named
        ],
        effect_probabilities=probabilities or {},
    )


def test_every_effect_has_one_check():
    assert EFFECT_CHECKS.keys() == EVERY_EFFECT.keys()
    assert len(set(EFFECT_CHECKS.values())) == len(EFFECT_CHECKS)
    assert all(text.endswith(".") for text in EFFECT_CHECKS.values())


def test_named_effects_come_first_then_likely_ones_then_look_alikes():
    found = document(
        ("creep + prebend", True, ["encoder_offset", "hysteresis"]), ("backlash", False, ["drag"]),
        probabilities={"stiction": 0.09, "hysteresis": 0.3, "creep": 0.9, "cogging": 0.4},
    )  # fmt: skip
    order = ["creep", "prebend", "cogging", "hysteresis", "encoder_offset"]
    assert list(effects_to_check(found)) == order


def test_no_more_are_told_than_a_person_looks_at_and_none_of_ones_own_effects():
    many = dict.fromkeys(EVERY_EFFECT, 0.5)
    assert len(effects_to_check(document(probabilities=many))) == MOST_CHECKS
    assert effects_to_check(document(("hose_spring", True, []))) == {}
    assert effects_to_check(document()) == {}


def test_what_would_take_up_the_rest_is_checked_too():
    further = FurtherEffect("unmodelled_payload", separation=57.0, least=16.0)
    given = {"verdict": "reduced", "further": further}
    assert list(effects_to_check(document(("backlash", True, []), **given))) == [
        "backlash", "unmodelled_payload",
    ]  # fmt: skip
