"""A map that names its link leaves out what the link's file says; its numbers have a range."""

import pytest

from firmware_py.errors import InputError
from firmware_py.link.link_description import LinkDescription
from firmware_py.link.link_file import link_toml
from models.trials.recordings.mapping import read_mapping

TRIAL = """
[trial]
payload_kg = 0.1
trial = 1
motion = "sinusoid"
period_s = 4.352
amplitude_rad = 0.5236
"""


def mapping(directory, joints, text):
    link = LinkDescription(length_m=0.6, width_m=0.1, joints=joints)
    (directory / "link.toml").write_text(link_toml(link, 1.0, 1.0), encoding="utf-8")
    (directory / "map.toml").write_text(text, encoding="utf-8")
    return read_mapping(directory / "map.toml")


@pytest.mark.parametrize("joints", [1, 2])
def test_the_joints_are_those_of_the_link_where_the_map_gives_none(tmp_path, joints):
    given = mapping(tmp_path, joints, 'link = "link.toml"\n' + TRIAL)
    meta = given.meta(rest_samples=20)
    assert (meta.dof, given.dof, meta.link_length_m) == (joints, joints, 0.6)


def test_the_maps_own_joints_count_more_than_the_links(tmp_path):
    meta = mapping(tmp_path, 2, 'link = "link.toml"\n' + TRIAL + "dof = 1\n").meta(20)
    assert meta.dof == 1


@pytest.mark.parametrize("step_s", ["17", "0.0", "1e-9"])
def test_a_step_of_another_unit_is_refused(tmp_path, step_s):
    with pytest.raises(InputError, match=r"map\.toml: step_s"):
        mapping(tmp_path, 1, f'step_s = {step_s}\nlink = "link.toml"\n' + TRIAL)


def test_a_period_of_zero_is_a_fault_of_the_map(tmp_path):
    text = 'link = "link.toml"\n' + TRIAL.replace("4.352", "0.0")
    with pytest.raises(InputError, match=r"map\.toml: period_s is 0\.0"):
        mapping(tmp_path, 1, text).meta(20)
