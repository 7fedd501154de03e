"""Drawn rigs: reproducible, different, never of a form that only rigs for testing have."""

import numpy as np
import pytest

from firmware_py.errors import InputError
from models.rig.drawn import draw_rig, rig_named, rig_purpose
from models.rig.parameters import named_structures, read_rig

MANY = [rig_named(f"drawn_{k}") for k in range(40)]


def test_a_name_gives_the_same_rig_again_and_each_name_another():
    assert [r.sha256() for r in MANY[:5]] == [rig_named(f"drawn_{k}").sha256() for k in range(5)]
    assert len({r.sha256() for r in MANY}) == len(MANY)
    assert len({r.structure for r in MANY}) > 30


def test_what_only_rigs_for_testing_have_is_never_drawn():
    for rig in MANY:
        s = rig.structure
        assert s.engine == "mujoco" and 5 < s.hinges < 17
        assert s.hysteresis != "dahl" and s.mocap_filter != "low_pass"


def test_no_effect_is_hidden_and_values_keep_their_bounds():
    own = read_rig("default")
    for rig in MANY:
        for name, entry in rig.entries.items():
            assert entry.minimum <= entry.value <= entry.maximum
            if own[name] == 0.0:
                assert entry.value == 0.0


def test_masses_differ_by_a_seventh_or_so():
    masses = [draw_rig(np.random.default_rng(k))["link.mass_kg"] for k in range(400)]
    assert np.std(np.log(masses)) == pytest.approx(0.15, rel=0.15)
    assert np.median(masses) == pytest.approx(0.9, rel=0.05)


def test_named_structures_are_found_too_and_what_is_no_number_is_refused():
    assert rig_named("test_a") == read_rig("test_a")
    with pytest.raises(InputError, match="drawn_x"):
        rig_named("drawn_x")


def test_drawn_rigs_from_number_900_on_are_for_tests_and_named_structures_say_their_purpose():
    drawn = {k: rig_purpose(f"drawn_{k}") for k in (0, 33, 899, 900, 901, 12000)}
    assert [k for k, purpose in drawn.items() if purpose == "test"] == [900, 901, 12000]
    assert {n: rig_purpose(n) for n in named_structures()} == {
        n: s.purpose for n, s in named_structures().items()
    }
    assert (rig_purpose("default"), rig_purpose("test_a")) == ("tuning", "test")
    assert rig_purpose("some/link.toml") == "tuning"  # nobody knows what was set on it
    with pytest.raises(InputError, match="drawn_9x"):
        rig_purpose("drawn_9x")
