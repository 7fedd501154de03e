"""Nothing is written that does not hold on what was left out."""

from dataclasses import replace

import msgspec
import pytest

from models.gap.report.gap_json import GapDocument
from models.gap.report.gap_page import write_gap_page
from models.gap.report.gap_results import gap_document
from models.gap.report.gap_words import gap_in_words

FRICTION_NM = 0.05


@pytest.fixture(scope="module")
def honest(pendulum, rough, swings, diagnosed_with):
    """The same friction with both payloads."""
    trials = swings({0.0: rough(FRICTION_NM), 0.2: rough(FRICTION_NM)})
    return diagnosed_with(pendulum, trials), trials


@pytest.fixture(scope="module")
def one_sided(pendulum, rough, swings, diagnosed_with):
    """Friction that only one payload shows: no value fits both."""
    trials = swings({0.0: rough(0.0), 0.2: rough(FRICTION_NM)})
    return diagnosed_with(pendulum, trials), trials


@pytest.fixture(scope="module")
def bounded(pendulum, rough, swings, diagnosed_with):
    """Friction larger than the plant file allows."""
    known = pendulum.expected["coulomb_friction_1_nm"]
    tight = replace(
        pendulum,
        expected=pendulum.expected
        | {"coulomb_friction_1_nm": msgspec.structs.replace(known, high=FRICTION_NM / 3)},
    )
    trials = swings({0.0: rough(FRICTION_NM), 0.2: rough(FRICTION_NM)})
    return diagnosed_with(tight, trials), trials


def test_an_effect_that_holds_everywhere_is_named_and_lowers_the_held_out_error(honest):
    found, _ = honest
    assert found.named == ("coulomb_friction",)
    assert found.left_out == ("payloads", "motions")
    assert found.unexplained_fraction < 0.5
    q = found.improved.parameters["coulomb_friction_1_nm"]
    assert q.value == pytest.approx(FRICTION_NM, rel=0.2)


def test_without_repetitions_the_verdict_is_no_floor_with_the_unexplained_fraction(honest):
    found, trials = honest
    document = gap_document(found, trials)
    assert document.verdict == "no floor"
    assert document.unexplained_fraction == pytest.approx(found.unexplained_fraction, abs=1e-3)
    text = gap_in_words(document)
    assert "verdict: no floor" in text
    assert "within the noise floor" not in text
    assert f"{found.unexplained_fraction:.0%} of the plant's error is unexplained" in text


def test_an_effect_that_only_one_payload_shows_is_not_written(one_sided):
    found, _ = one_sided
    assert found.named == ()
    assert found.improved.parameters == found.plant.parameters
    assert found.improved.effects == found.plant.effects
    assert found.verdict != "closed"
    assert not any(i.kept for i in found.inclusions)


def test_a_value_at_its_bound_refuses_the_effect_and_is_said(bounded, tmp_path):
    found, trials = bounded
    assert found.named == ()
    assert found.improved.parameters == found.plant.parameters
    (row,) = found.refused
    assert (row.effect, row.kind) == ("coulomb_friction", "at a bound")
    assert row.limit == pytest.approx(FRICTION_NM / 3)
    document = gap_document(found, trials)
    said = "Coulomb friction was refused: coulomb_friction_1_nm ended at its upper bound"
    assert said in gap_in_words(document)
    page = write_gap_page(document, found.plant, found.improved, trials, tmp_path / "page.html")
    text = page.read_text(encoding="utf-8")
    assert said in text


@pytest.mark.parametrize("case", ["honest", "one_sided", "bounded"])
def test_no_signal_is_worse_held_out_than_with_the_plant_as_given(request, case):
    found, _ = request.getfixturevalue(case)
    assert found.held_out_given.keys() == found.held_out_improved.keys()
    for signal, given in found.held_out_given.items():
        assert found.held_out_improved[signal] <= 1.05 * given


def test_a_document_without_the_new_keys_is_still_read(honest):
    found, trials = honest
    data = msgspec.to_builtins(gap_document(found, trials))
    for key in ("refused", "held_out", "unexplained_fraction"):
        del data[key]
    assert msgspec.convert(data, GapDocument).refused == ()
