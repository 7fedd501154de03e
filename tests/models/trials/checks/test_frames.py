"""Tilted and left-handed frames of a motion capture are named, with remedies that mend them."""

import msgspec
import numpy as np
import pytest

from models.trials.checks.pose import judge_pose, rest_pose
from models.trials.recordings.mapping import MocapFrame, RecordingMap
from models.trials.recordings.series import nominal_markers_m, to_world
from models.trials.trial import TrialMeta

META = TrialMeta(
    dof=1, payload_kg=1.0, trial=1, motion="step", source="measured", period_s=1.0,
    base_offset_m=0.06, link_length_m=0.95, link_width_m=0.15, rest_samples=1,
)  # fmt: skip
PLACES_M = nominal_markers_m(META)
MARKERS = META.layout.names
HEIGHT_M = 1.01


def about_y(degrees):
    turn = np.radians(degrees)
    return np.array(
        [[np.cos(turn), 0, np.sin(turn)], [0, 1.0, 0], [-np.sin(turn), 0, np.cos(turn)]]
    )


def judged(in_file_m, frame=None, names=MARKERS):
    """Pose and findings of markers as a file has them."""
    frame = frame or MocapFrame()
    places_m = {n: to_world(m, frame, "z") for n, m in zip(names, in_file_m, strict=True)}
    pose = rest_pose(places_m, META)
    return pose, judge_pose(pose, RecordingMap(frame=frame), "z")


@pytest.mark.parametrize("degrees", [1.9, 3.0, -4.0])
def test_a_frame_tilted_about_the_origin_is_a_tilt_and_no_shift(degrees):
    pose, (finding,) = judged(PLACES_M @ about_y(degrees).T)
    assert (finding.level, finding.cause) == ("warning", "tilt")
    aside_m = HEIGHT_M * np.sin(np.radians(abs(degrees)))
    assert pose.tip_aside_m == pytest.approx(aside_m, abs=1e-4)
    assert f"{1e3 * aside_m:.0f}\xa0mm" in finding.text
    assert "a prebend of the link, a tilted frame" in finding.text
    assert 'align = "base"' in finding.remedy and "origin_m" not in finding.remedy


def test_an_origin_that_hides_a_tilt_at_the_lowest_row_leaves_the_tilt():
    """What followed from the former remedy: the tip is still 24 mm aside."""
    _, found = judged(PLACES_M @ about_y(1.9).T, MocapFrame(origin_m=(0.010, 0.0, 0.0)))
    assert [f.cause for f in found] == ["tilt"]


def test_a_tilt_beside_a_wrong_height_keeps_the_remedy_for_the_height():
    _, found = judged(PLACES_M @ about_y(1.9).T + [0, 0, 0.05])
    tilt, origin = found
    assert (tilt.cause, origin.cause) == ("tilt", "origin")
    stated = [float(v) for v in origin.remedy.split("[")[1].split("]")[0].split(",")]
    assert stated == pytest.approx([0, 0, 0.05], abs=1e-3)


def test_no_origin_is_proposed_where_the_tilt_moves_it_as_much():
    about_the_middle = (PLACES_M - [0, 0, 0.6]) @ about_y(1.9).T + [0, 0, 0.6]
    _, found = judged(about_the_middle)
    assert [f.cause for f in found] == ["tilt", "origin"]
    assert "correct the tilt first" in found[1].remedy


@pytest.mark.parametrize("prebend_rad", [0.01, 0.02])
def test_a_usual_prebend_is_not_called_wrong(prebend_rad):
    """Spread over the span as on the rig: it moves the tip by half of the angle times length."""
    z = PLACES_M[:, 2] - 0.06
    bent = PLACES_M + np.outer(prebend_rad * z**2 / (2 * 0.95), [1.0, 0, 0])
    pose, found = judged(bent)
    assert found == []
    assert pose.tip_aside_m == pytest.approx(0.5 * prebend_rad * 0.95, abs=1e-4)


@pytest.mark.parametrize("axis", ["x", "y", "z"])
@pytest.mark.parametrize("up", ["z", "y"])
def test_the_remedy_for_a_left_handed_file_brings_the_robot_back(axis, up):
    """The marker names are right: the map must not exchange them."""
    right_handed = PLACES_M if up == "z" else PLACES_M[:, [0, 2, 1]] * [1, 1, -1]
    left_handed = right_handed * [-1.0 if a == axis else 1.0 for a in "xyz"]
    frame = MocapFrame(up=up)
    _, found = judged(left_handed, frame)
    assert found[0].cause == "swapped" and "left-handed" in found[0].text
    assert found[0].remedy.startswith(f'set mirror = "{axis}" under [frame]')
    mended = msgspec.structs.replace(frame, mirror=axis)
    pose, found = judged(left_handed, mended)
    assert found == []
    assert pose.measured_m == pytest.approx(PLACES_M)


def test_exchanged_axes_are_mended_in_two_steps():
    in_file = PLACES_M[:, [1, 0, 2]]
    _, (first,) = judged(in_file)
    axis = first.remedy.split('"')[1]
    _, (second,) = judged(in_file, MocapFrame(mirror=axis))
    yaw_deg = float(second.remedy.split("yaw_deg = ")[1].split()[0])
    pose, found = judged(in_file, MocapFrame(mirror=axis, yaw_deg=yaw_deg))
    assert found == []
    assert pose.measured_m == pytest.approx(PLACES_M, abs=1e-9)


def test_a_mirror_that_is_not_in_the_file_is_told():
    _, (finding,) = judged(PLACES_M, MocapFrame(mirror="x"))
    assert finding.level == "refused" and 'with mirror = "x"' in finding.text
    assert "leave mirror out" in finding.remedy


def test_the_origin_is_counted_after_the_mirror():
    shift_m = np.array([0.1, 0.05, 0.4])
    seen = (PLACES_M + shift_m) * [-1, 1, 1]
    _, (finding,) = judged(seen, MocapFrame(mirror="x"))
    stated = [float(v) for v in finding.remedy.split("[")[1].split("]")[0].split(",")]
    assert stated == pytest.approx(shift_m, abs=1e-3)


def test_corners_in_an_order_that_is_no_reflection_are_names():
    order = [4 * (k // 4) + (1, 0, 2, 3)[k % 4] for k in range(16)]
    _, found = judged(PLACES_M[order])
    assert found[0].cause == "swapped" and "left-handed" not in found[0].text
