"""Rigs by name, by number and by file."""

import numpy as np
import pytest

from firmware_py.core.errors import InputError
from models.rig.drawn import rig_named, rig_purpose
from models.rig.parameters import read_parameters

DRAWN = [rig_named(f"drawn_{k}") for k in range(40)]


def test_a_number_draws_the_same_rig_again_and_each_number_another():
    assert [r.sha256() for r in DRAWN[:5]] == [rig_named(f"drawn_{k}").sha256() for k in range(5)]
    assert len({r.sha256() for r in DRAWN}) == len(DRAWN)
    assert len({r.structure for r in DRAWN}) > 30


def test_drawn_rigs_have_no_form_of_rigs_for_testing_and_no_hidden_effect():
    default = rig_named("default")
    masses_kg = [rig["link.mass_kg"] for rig in DRAWN]
    assert np.std(np.log(masses_kg)) == pytest.approx(0.15, rel=0.3)
    for rig in DRAWN:
        s = rig.structure
        assert s.engine == "mujoco" and 5 < s.hinges < 17
        assert s.hysteresis != "dahl" and s.mocap_filter != "low_pass"
        for name, entry in rig.entries.items():
            assert entry.minimum <= entry.value <= entry.maximum
            assert default[name] != 0.0 or entry.value == 0.0


def test_drawn_rigs_from_number_900_on_are_for_testing():
    purposes = {k: rig_purpose(f"drawn_{k}") for k in (0, 899, 900, 12000)}
    assert [k for k, purpose in purposes.items() if purpose == "test"] == [900, 12000]
    assert (rig_purpose("default"), rig_purpose("test_a")) == ("tuning", "test")
    assert rig_purpose("some/link.toml") == "tuning"  # what was set on it is unknown
    for reads in (rig_purpose, rig_named):
        with pytest.raises(InputError, match="drawn_9x"):
            reads("drawn_9x")


HEAD = 'summary = "one"\npurpose = "test"\n[structure]\n'


def read(tmp_path, text):
    path = tmp_path / "ours.toml"
    path.write_text(text)
    return rig_named(str(path))


def value(name, number, unit, more=""):
    return f'[{name}]\nvalue = {number}\nunit = "{unit}"\nsource = "us"\n{more}'


def test_a_file_changes_structure_and_values_but_neither_effects_nor_bounds(tmp_path):
    text = HEAD + 'goal = "profile"\n' + value("servo.backlash_rad", 0.002, "rad", "maximum = 9\n")
    rig = read(tmp_path, text)
    assert rig.structure.goal == "profile" and rig["servo.backlash_rad"] == 0.002
    assert rig.hide({"backlash": 0.004})["servo.backlash_rad"] == pytest.approx(0.006)
    assert rig["link.mass_kg"] == read_parameters()["link.mass_kg"]
    with pytest.raises(InputError, match=r"outside 0 to 0\.1"):
        rig.hide({"backlash": 1.0})


@pytest.mark.parametrize(
    "text, message",
    [
        (HEAD + 'goal = "guessed"', "guessed"),
        (HEAD + "hinges = 4", ">= 5"),
        (HEAD.replace('"test"', '"fun"'), "purpose"),
        (HEAD + value("link.weight", 1.0, "kg"), "link.weight is unknown"),
        (value("link.mass_kg", 900, "g"), "give it in kg"),
        (value("link.mass_kg", "nan", "kg"), "bounds"),
        (value("servo.backlash_rad", 0.01, "rad", 'effect = "creep"'), "not the parameter of"),
        ("[link.mass_kg", "TOML"),
    ],
)
def test_a_damaged_file_is_refused_in_one_sentence(tmp_path, text, message):
    with pytest.raises(InputError, match=message):
        read(tmp_path, text)
