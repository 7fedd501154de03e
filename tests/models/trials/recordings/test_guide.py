"""The guide's examples are read by what reads a user's."""

import re
from pathlib import Path

import pytest

from models.trials.files import read_trial, write_trial
from models.trials.recordings.mapping import read_mapping

GUIDE = Path("docs/trials.md").read_text(encoding="utf-8")
CONDITIONS, *MAPS = re.findall(r"```toml\n(.*?)```", GUIDE, re.DOTALL)


@pytest.mark.parametrize("text", MAPS, ids=["motive", "table", "rosbag"])
def test_every_map_of_the_guide_is_one(text, tmp_path):
    path = tmp_path / "map.toml"
    path.write_text(text, encoding="utf-8")
    mapping = read_mapping(path)
    assert mapping.meta(rest_samples=60).dof == mapping.dof
    assert mapping.columns or mapping.markers or mapping.topics


def test_the_guides_conditions_are_those_of_a_trial(make_trial, swing_rad, tmp_path):
    path = write_trial(make_trial(swing_rad), tmp_path)
    path.with_suffix(".toml").write_text(
        CONDITIONS.replace("rest_samples = 60", "rest_samples = 3"), encoding="utf-8"
    )
    assert read_trial(path).meta.payload_kg == 1.0
