"""What is written errs less on what was left out, whatever is named."""

from dataclasses import replace

import msgspec
import pytest

from models.gap.decision.written_fit import PlantWriter

FRICTION_NM = 0.05


@pytest.fixture(scope="module")
def honest(pendulum, rough, swings, diagnosed_with):
    """The same friction with both payloads."""
    trials = swings({0.0: rough(FRICTION_NM), 0.2: rough(FRICTION_NM)})
    return diagnosed_with(pendulum, trials)


@pytest.fixture(scope="module")
def one_sided(pendulum, rough, swings, diagnosed_with):
    """Friction that only one payload shows: no value fits both."""
    trials = swings({0.0: rough(0.0), 0.2: rough(FRICTION_NM)})
    return diagnosed_with(pendulum, trials)


@pytest.fixture(scope="module")
def bounded(pendulum, rough, swings, diagnosed_with):
    """Friction larger than the plant file allows."""
    known = pendulum.expected["coulomb_friction_1_nm"]
    tight = replace(
        pendulum,
        expected=pendulum.expected
        | {"coulomb_friction_1_nm": msgspec.structs.replace(known, high=FRICTION_NM / 3)},
    )
    return diagnosed_with(tight, swings({0.0: rough(FRICTION_NM), 0.2: rough(FRICTION_NM)}))


def test_an_effect_that_holds_everywhere_is_named_and_lowers_the_held_out_error(honest):
    assert honest.named == honest.written.candidates == ("coulomb_friction",)
    assert honest.verdict == "no floor", "no trial was repeated"
    assert honest.left_out == ("payloads", "motions")
    assert honest.unexplained_fraction < 0.5
    q = honest.improved.parameters["coulomb_friction_1_nm"]
    assert q.value == pytest.approx(FRICTION_NM, rel=0.2)


def test_without_a_floor_an_effect_that_only_one_payload_shows_is_not_named(one_sided):
    assert one_sided.named == ()
    assert one_sided.improved.parameters == one_sided.plant.parameters


def test_a_strength_at_its_bound_names_nothing(bounded):
    assert bounded.named == ()
    assert bounded.improved.effects == bounded.plant.effects


@pytest.mark.parametrize("case", ["honest", "one_sided", "bounded"])
def test_no_signal_is_worse_held_out_than_with_the_plant_as_given(request, case):
    found = request.getfixturevalue(case)
    errors = found.written.errors.rms()
    assert errors.keys() == found.held_out_baseline.keys()
    assert all(errors[s] <= 1.05 * rms for s, rms in found.held_out_baseline.items())


@pytest.mark.slow
def test_a_name_stands_whose_plant_is_worse_on_what_was_left_out(plant, hidden, diagnosed):
    """The check decides on the plant alone: here it refuses every fit with an effect."""
    trials = hidden(dead_time_1_s=0.02)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(PlantWriter, "_failure", lambda self, fit: "worse" if fit.candidates else "")
        found = diagnosed(plant, trials)
    assert found.named == ("dead_time",) and found.verdict == "closed"
    assert found.written.candidates == () and found.written.refused == "worse"
    assert "dead_time" not in found.improved.effects
    assert "dead_time" in found.fitted.effects
