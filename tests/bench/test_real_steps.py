"""Steps of the benchmark on recordings are kept for the code that did them, and for no other."""

import pytest

from bench.real import keep_steps_of_this_code
from firmware_py.errors import InputError


def test_steps_of_the_same_code_stay_and_those_of_other_code_are_deleted(tmp_path):
    directory = tmp_path / "emps"
    keep_steps_of_this_code(directory, "a")
    step = directory / "plant.json"
    step.write_text("{}")
    keep_steps_of_this_code(directory, "a")
    assert step.exists()
    keep_steps_of_this_code(directory, "b")
    assert not step.exists()


def test_a_directory_that_it_did_not_make_is_left_alone(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="delete it or change --out"):
        keep_steps_of_this_code(tmp_path, "a")
    assert (tmp_path / "notes.txt").read_text() == "mine"
