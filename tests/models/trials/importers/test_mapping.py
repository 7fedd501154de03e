"""A map that names its link leaves out what the link's file says."""

import pytest

from firmware_py.link.link_description import LinkDescription
from firmware_py.link.link_file import link_toml
from models.trials.importers.mapping import read_mapping

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
