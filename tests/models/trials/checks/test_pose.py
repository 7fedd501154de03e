"""Pose at rest: wrong names, frames and sizes are named, and right ones pass."""

from pathlib import Path

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from firmware_py.link.marker_layout import square_layout
from models.trials.checks.markers import judge_markers
from models.trials.checks.pose import judge_base, judge_pose, nominal_sag_m, rest_pose
from models.trials.recordings.mapping import MocapFrame, RecordingMap
from models.trials.recordings.series import Series, marker_columns, nominal_markers_m, to_world
from models.trials.trial import TrialMeta

META = TrialMeta(
    dof=1, payload_kg=1.0, trial=1, motion="step", source="measured", period_s=1.0,
    base_offset_m=0.06, link_length_m=0.95, link_width_m=0.15, rest_samples=1,
)  # fmt: skip
PLACES_M = nominal_markers_m(META)
LYING_M_S2 = (-9.81, 0.0, 0.0)


def about(axis, degrees):
    return Rotation.from_euler(axis, degrees, degrees=True).as_matrix()


def judged(places_m, frame=None, meta=META, rest_rad=None):
    """Pose and findings of markers at places in a file."""
    frame = frame or MocapFrame()
    in_world_m = {
        n: to_world(m, frame, "z") for n, m in zip(meta.layout.names, places_m, strict=True)
    }
    pose = rest_pose(in_world_m, meta, rest_rad)
    return pose, judge_pose(pose, RecordingMap(frame=frame), "z")


def noisy(places_m):
    """Markers are placed by hand, to a millimetre."""
    return places_m + 0.001 * np.random.default_rng(1).standard_normal(places_m.shape)


def proposed_origin_m(finding):
    return [float(v) for v in finding.remedy.split("[")[1].split("]")[0].split(",")]


def test_a_right_pose_has_no_findings():
    places_m = noisy(PLACES_M)
    places_m[[2, 9]] = np.nan  # occluded
    assert judged(places_m)[1] == []


def test_a_usual_prebend_has_no_findings():
    """Spread over the span as on the rig: it moves the tip by half of the angle times length."""
    z = PLACES_M[:, 2] - 0.06
    pose, found = judged(PLACES_M + np.outer(0.02 * z**2 / (2 * 0.95), [1.0, 0, 0]))
    assert found == []
    assert pose.tip_aside_m == pytest.approx(0.5 * 0.02 * 0.95, abs=1e-4)


# Names


@pytest.mark.parametrize("pairs", [[(1, 13)], [(4, 5), (9, 14), (0, 2)]])
def test_exchanged_markers_are_named(pairs):
    places_m = noisy(PLACES_M) @ about("z", 90).T  # the frame may be wrong too
    for pair in pairs:
        places_m[list(pair)] = places_m[list(reversed(pair))]
    _, (finding, yaw) = judged(places_m)
    assert (finding.level, finding.cause, yaw.cause) == ("refused", "swapped", "yaw")
    for pair in pairs:
        assert " and ".join(META.layout.names[k] for k in pair) + " are swapped" in finding.text


@pytest.mark.parametrize(
    ("rows", "corners", "words"),
    [
        ([3, 2, 1, 0], [0, 1, 2, 3], "rows are named in the order 4, 3, 2, 1"),
        ([0, 1, 2, 3], [1, 0, 3, 2], "the file's axes are left-handed"),
        ([0, 1, 2, 3], [1, 0, 2, 3], "corners are named in the order 2, 1, 3, 4"),
    ],
)
def test_rows_and_corners_in_another_order_are_named(rows, corners, words):
    order = (4 * np.array(rows)[:, None] + corners).ravel()
    _, found = judged(noisy(PLACES_M)[order])
    assert found[0].cause == "swapped" and found[0].text.startswith(words)


def test_names_of_one_row_in_a_circle_are_named():
    order = [*range(8), 9, 11, 8, 10, *range(12, 16)]
    _, (finding,) = judged(PLACES_M[order])
    assert finding.cause == "swapped" and "m09 is in the place of m10" in finding.text


def test_one_pair_of_two_rows_is_no_mirror():
    meta = msgspec.structs.replace(META, markers=square_layout(0.95, 0.15, rows=2))
    places_m = noisy(nominal_markers_m(meta))
    places_m[[0, 4]] = places_m[[4, 0]]
    one, other = meta.layout.names[0], meta.layout.names[4]
    assert judged(places_m, meta=meta)[0].order == f"{one} and {other} are swapped"


def test_markers_of_the_base_are_not_missed():
    names = (*META.layout.names, "b01", "b02", "b03", "b04")
    columns = marker_columns({name: np.zeros((3, 3)) for name in names})
    mapping = RecordingMap(markers={name: name for name in names})
    assert judge_markers([Series(np.arange(3.0), columns, Path("take.csv"))], mapping) == []


# Left-handed files


@pytest.mark.parametrize(("axis", "up"), [("x", "z"), ("y", "y"), ("z", "y")])
def test_the_remedy_for_a_left_handed_file_corrects_it(axis, up):
    """The marker names are right: the map must not exchange them."""
    right_handed = PLACES_M if up == "z" else PLACES_M[:, [0, 2, 1]] * [1, 1, -1]
    left_handed = right_handed * [-1.0 if a == axis else 1.0 for a in "xyz"]
    _, found = judged(left_handed, MocapFrame(up=up))
    assert found[0].cause == "swapped" and "left-handed" in found[0].text
    assert found[0].remedy.startswith(f'set mirror = "{axis}" under [frame]')
    pose, found = judged(left_handed, MocapFrame(up=up, mirror=axis))
    assert found == []
    assert pose.measured_m == pytest.approx(PLACES_M)


@pytest.mark.parametrize(("rows", "gravity"), [(2, (0.0, 0.0, -9.81)), (3, LYING_M_S2)])
def test_a_left_handed_file_of_few_rows_is_recognised(rows, gravity):
    layout = square_layout(0.95, 0.15, rows=rows)
    meta = msgspec.structs.replace(META, markers=layout, gravity_m_s2=gravity)
    places_m = nominal_markers_m(meta) + nominal_sag_m(meta, np.eye(3))
    _, (finding,) = judged(noisy(places_m) * [1.0, -1.0, 1.0], meta=meta)
    assert "left-handed" in finding.text and 'mirror = "y"' in finding.remedy
    assert "corners are named in the order 3, 4, 1, 2" in finding.text


def test_exchanged_axes_are_corrected_in_two_steps():
    in_file = PLACES_M[:, [1, 0, 2]]
    axis = judged(in_file)[1][0].remedy.split('"')[1]
    _, (second,) = judged(in_file, MocapFrame(mirror=axis))
    yaw_deg = float(second.remedy.split("yaw_deg = ")[1].split()[0])
    pose, found = judged(in_file, MocapFrame(mirror=axis, yaw_deg=yaw_deg))
    assert found == []
    assert pose.measured_m == pytest.approx(PLACES_M, abs=1e-9)


def test_a_mirror_that_is_not_in_the_file_is_refused():
    _, (finding,) = judged(PLACES_M, MocapFrame(mirror="x"))
    assert finding.level == "refused" and 'with mirror = "x"' in finding.text


# Frame and origin


@pytest.mark.parametrize(
    ("places_m", "level", "cause", "words"),
    [
        (PLACES_M @ about("z", 3).T, "warning", "yaw", "turned by 3.0"),
        (PLACES_M @ about("z", -29).T, "refused", "yaw", "turned by -29.0"),
        (PLACES_M[:, [2, 0, 1]], "refused", "up axis", "the file is x-up"),
        (PLACES_M + np.array([0, 0, 0.42]), "refused", "origin", "0.420 m too low"),
        (PLACES_M + np.array([0.1, 0, 0]), "refused", "origin", "0.100 m aside"),
        (PLACES_M @ about("y", -4).T, "warning", "tilt", "its tip 70\xa0mm aside"),
    ],
)
def test_a_wrong_frame_is_named_with_its_size(places_m, level, cause, words):
    _, (finding,) = judged(places_m)
    assert (finding.level, finding.cause) == (level, cause) and words in finding.text


@pytest.mark.parametrize(
    ("frame", "origin_m"),
    [
        (MocapFrame(yaw_deg=40.0, origin_m=(1.0, 2.0, 0.5)), [1.1, 1.8, 0.9]),
        (MocapFrame(mirror="x"), [0.1, 0.05, 0.4]),
    ],
)
def test_the_proposed_origin_is_right_in_a_turned_or_mirrored_frame(frame, origin_m):
    in_file = PLACES_M @ about("z", -frame.yaw_deg).T + origin_m
    _, (finding,) = judged(in_file * [-1 if frame.mirror else 1, 1, 1], frame)
    assert proposed_origin_m(finding) == pytest.approx(origin_m, abs=1e-3)


def test_a_tilt_is_named_beside_an_origin_that_hides_it_or_goes_with_it():
    _, found = judged(PLACES_M @ about("y", 1.9).T, MocapFrame(origin_m=(0.010, 0.0, 0.0)))
    assert [f.cause for f in found] == ["tilt"]
    _, (tilt, origin) = judged(PLACES_M @ about("y", 1.9).T + [0, 0, 0.05])
    assert (tilt.cause, origin.cause) == ("tilt", "origin")
    assert proposed_origin_m(origin) == pytest.approx([0, 0, 0.05], abs=1e-3)
    _, found = judged((PLACES_M - [0, 0, 0.6]) @ about("y", 1.9).T + [0, 0, 0.6])
    assert [f.cause for f in found] == ["tilt", "origin"]
    assert "correct the tilt first" in found[1].remedy


def test_a_link_that_rests_at_an_angle_has_no_tilt():
    places_m = PLACES_M @ about("y", np.degrees(0.2)).T
    assert judged(places_m, rest_rad=np.array([0.2]))[1] == []
    assert judged(places_m)[1][0].cause == "tilt"


@pytest.mark.parametrize("softer", [0.5, 2.0])
def test_the_sag_of_a_lying_link_is_no_tilt(softer):
    """Cantilever under its payload: it leans by 2 to 8°."""
    lying = msgspec.structs.replace(META, payload_kg=0.5, gravity_m_s2=LYING_M_S2)
    places_m = PLACES_M + softer * nominal_sag_m(lying, np.eye(3))
    assert judged(places_m, meta=lying)[1] == []
    aligned = MocapFrame(align="rest")  # which would remove the sag
    assert [f.cause for f in judged(places_m, aligned, meta=lying)[1]] == ["sag"]
    if softer > 1:  # an upright link does not lie like that
        assert judged(places_m)[1][0].cause == "tilt"


def test_alignment_corrects_the_frame_and_not_the_scale():
    aligned = MocapFrame(align="rest")
    assert judged(PLACES_M @ about("z", 29).T, aligned)[1] == []
    _, (finding,) = judged(1.1 * PLACES_M, aligned)
    assert (finding.level, finding.cause) == ("refused", "scale")


def test_base_markers_in_another_order_turn_the_link():
    for places_m in (PLACES_M * [1.0, -1.0, -1.0], PLACES_M @ about("z", 90).T):
        assert [f.cause for f in judge_base(judged(places_m)[0])] == ["base"]
    assert judge_base(judged(noisy(PLACES_M))[0]) == []
