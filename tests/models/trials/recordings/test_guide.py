"""The guide's examples are read by what reads a user's."""

import re
from pathlib import Path

import numpy as np
import pytest

from models.trials.files import read_trial, write_trial
from models.trials.recordings.mapping import read_mapping
from tests.models.trials.recordings.written_takes import WrittenTake, rigid_trial

GUIDE = Path("docs/trials.md").read_text(encoding="utf-8")
CONDITIONS, *MAPS = re.findall(r"```toml\n(.*?)```", GUIDE, re.DOTALL)


@pytest.mark.parametrize("text", MAPS, ids=["motive", "table", "rosbag"])
def test_every_map_of_the_guide_is_one(text, tmp_path):
    path = tmp_path / "map.toml"
    path.write_text(text, encoding="utf-8")
    mapping = read_mapping(path)
    assert mapping.meta(rest_samples=60).dof == mapping.dof
    assert mapping.columns or mapping.servo_columns or mapping.topics


def test_the_map_of_motive_and_a_servo_imports_a_take_as_printed(rigid_markers, run, tmp_path):
    """The clock of the servo is ahead of the capture's, whose frame lies elsewhere with y up."""
    time_s = 0.017 * np.arange(600)
    swing = -0.5236 * np.sin(2 * np.pi / 4.352 * np.clip(time_s - 1.02, 0, 2 * 4.352))
    take = WrittenTake(offset_s=-3.2, base="plate")
    take.write(rigid_trial(swing[:, None]), tmp_path, 1)
    servo = (tmp_path / "servo.csv").read_text().replace("goal1;pos1;cur1", "goal;position;current")
    (tmp_path / "servo.csv").write_text(servo)
    (tmp_path / "map.toml").write_text(MAPS[0], encoding="utf-8")
    code, out, err = run(
        tmp_path / "take.csv", "--as", "motive", "--servo", tmp_path / "servo.csv",
        "--map", tmp_path / "map.toml",
    )  # fmt: skip
    assert code == 0, err
    assert "servo clock -3.200" in out and "no warnings" in out, err
    trial = read_trial(tmp_path / "trials" / "take.csv")
    rigid_m = rigid_markers(np.pad(trial.angle_rad, ((0, 0), (0, 1))))
    assert np.abs(trial.markers_m - rigid_m).max() < 2e-3


def test_the_guides_conditions_are_those_of_a_trial(make_trial, swing_rad, tmp_path):
    path = write_trial(make_trial(swing_rad), tmp_path)
    path.with_suffix(".toml").write_text(
        CONDITIONS.replace("rest_samples = 60", "rest_samples = 3"), encoding="utf-8"
    )
    assert read_trial(path).meta.payload_kg == 1.0
