"""The guide's examples are read by what reads a user's."""

import re
from pathlib import Path

import pytest

from models.trials.importers.mapping import read_mapping
from models.trials.trial import TrialMeta
from models.trials.trial_files import read_trial, write_trial

GUIDE = Path("docs/trials.md").read_text(encoding="utf-8")
CONDITIONS, *MAPS = re.findall(r"```toml\n(.*?)```", GUIDE, re.DOTALL)


@pytest.mark.parametrize("text", MAPS, ids=["motive", "table", "rosbag"])
def test_every_map_of_the_guide_is_one(text, tmp_path):
    path = tmp_path / "map.toml"
    path.write_text(text, encoding="utf-8")
    mapping = read_mapping(path)
    assert mapping.meta(rest_samples=60).dof == mapping.dof
    assert mapping.columns or mapping.markers or mapping.topics


def test_the_guides_conditions_are_complete(make_trial, swing_rad, tmp_path):
    path = write_trial(make_trial(swing_rad), tmp_path)
    path.with_suffix(".toml").write_text(
        CONDITIONS.replace("rest_samples = 60", "rest_samples = 3"), encoding="utf-8"
    )
    assert read_trial(path).meta.payload_kg == 1.0
    listed = set(re.findall(r"^(\w+) =", CONDITIONS, re.MULTILINE))
    assert listed == set(TrialMeta.__struct_fields__) - {"conditions", "markers"}  # tables


def test_refusals_point_to_the_guide():
    for path in ("models/trials/trial_files.py", "models/trials/importers/mapping.py"):
        assert "docs/trials.md" in Path(path).read_text(encoding="utf-8")
