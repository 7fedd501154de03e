"""The guide's examples are read by what reads a user's."""

import re
from pathlib import Path

import numpy as np
import pytest

from models.shared.kinematics import base_rotation
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
    assert mapping.columns or mapping.servo_columns or mapping.topics


def test_motive_and_a_servos_csv_become_a_trial_by_the_map_as_printed(rigid_markers, run, tmp_path):
    """The servo's clock is ahead of the capture's, whose frame lies elsewhere and has y up."""
    time_s = np.arange(0, 10, 1 / 120)
    swing = -0.5236 * np.sin(2 * np.pi / 4.352 * np.clip(time_s - 1.0, 0, 2 * 4.352))
    angle = np.column_stack([swing, 0 * swing])
    base_m = [(x, y, 0.06) for y in (0.075, -0.075) for x in (0.075, -0.075)]
    corners_m = np.einsum("nij,kj->nki", base_rotation(angle), np.array(base_m))
    world_m = np.concatenate([rigid_markers(angle), corners_m], axis=1)
    y_up_m = np.stack([world_m[..., 0], world_m[..., 2], -world_m[..., 1]], axis=-1)
    names = [f"Link:m{k:02d}" for k in range(1, 17)] + [f"Base:b{k:02d}" for k in range(1, 5)]
    labels = [name for name in names for _ in "XYZ"]
    head = [
        "Format Version,1.23,Length Units,Meters,Coordinate Space,Global", "",
        ",Type," + ",".join(["Marker"] * 60), ",Name," + ",".join(labels),
        ",," + ",".join(["Position"] * 60), "Frame,Time (Seconds)," + ",".join("XYZ" * 20),
    ]  # fmt: skip
    rows = zip(time_s, (y_up_m + np.array([1.2, 0.4, -0.3])).reshape(len(time_s), 60), strict=True)
    lines = [f"{k},{t:.6f}," + ",".join(f"{v:.6f}" for v in m) for k, (t, m) in enumerate(rows)]
    (tmp_path / "take.csv").write_text("\n".join([*head, *lines]) + "\n")
    ticks = np.arange(0, 10, 0.017)
    goal = np.degrees(np.interp(ticks, time_s, swing))
    servo = np.column_stack([1e3 * (ticks + 3.2), goal, goal, 1500 * np.cos(ticks)])
    header = "stamp,goal,position,current"
    np.savetxt(tmp_path / "servo.csv", servo, "%.4f", ",", header=header, comments="")
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
