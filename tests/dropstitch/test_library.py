"""Library: its names, and what it says without the workshop."""

import importlib
import math

import pytest

import dropstitch


def test_every_name_is_there():
    for name in dropstitch.__all__:
        assert hasattr(dropstitch, name), name
    assert set(dir(dropstitch)) == set(dropstitch.__all__)
    assert dropstitch.read_plant is importlib.import_module("models.plant.plant").read_plant


def test_a_name_that_is_not_listed_is_no_attribute():
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = dropstitch.no_such_name
    assert not hasattr(dropstitch, "models")


def test_without_the_workshop_a_name_says_what_to_do(monkeypatch):
    def without(module):
        raise ModuleNotFoundError(f"No module named {module!r}", name="casadi")

    monkeypatch.delitem(vars(dropstitch), "diagnose", raising=False)
    monkeypatch.setattr(importlib, "import_module", without)
    with pytest.raises(ImportError, match=r"^dropstitch\.diagnose belongs .* casadi .*setup'\.$"):
        _ = dropstitch.diagnose


def test_what_cannot_be_is_refused_in_one_sentence():
    nothing = dropstitch.TrialSet(())
    for use in (dropstitch.diagnose, dropstitch.identify):
        with pytest.raises(dropstitch.InputError, match=r"^trials: are none; give"):
            use(None, nothing)
    rig = dropstitch.rig_named("default")
    for payload_kg in (-1.0, math.nan):
        with pytest.raises(dropstitch.InputError, match=r"^payload_kg: is"):
            dropstitch.run_case(rig, dropstitch.TrialCase(dropstitch.Motion(), payload_kg, 1))
