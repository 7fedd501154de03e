"""The pose at rest tells what is wrong with names, frame and size, and passes what is right."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from firmware_py.link.marker_layout import square_layout
from models.trials.checks.markers import judge_markers
from models.trials.checks.pose import judge_base, judge_pose, nominal_sag_m, rest_pose
from models.trials.recordings.mapping import MocapFrame, RecordingMap
from models.trials.recordings.series import Series, marker_columns, nominal_markers_m
from models.trials.trial import TrialMeta

META = TrialMeta(
    dof=1, payload_kg=1.0, trial=1, motion="step", source="measured", period_s=1.0,
    base_offset_m=0.06, link_length_m=0.95, link_width_m=0.15, rest_samples=1,
)  # fmt: skip
PLACES_M = nominal_markers_m(META)
MARKERS = META.layout.names


def about_z(degrees):
    turn = np.radians(degrees)
    return np.array(
        [[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1.0]]
    )


def judged(places_m, frame=None, names=MARKERS):
    pose = rest_pose(dict(zip(names, places_m, strict=True)), META)
    return [
        (f.level, f.cause, f.text)
        for f in judge_pose(pose, RecordingMap(frame=frame or MocapFrame()), "z")
    ]


def noisy(places_m, size_m=0.001):
    """Markers are placed by hand."""
    return places_m + size_m * np.random.default_rng(1).standard_normal(places_m.shape)


def test_a_right_pose_has_no_findings():
    lean = PLACES_M + np.outer(PLACES_M[:, 2] ** 2, [0.01, 0, 0])  # prebend
    assert judged(noisy(lean)) == []
    missing = np.array(noisy(PLACES_M))
    missing[[2, 9]] = np.nan
    assert judged(missing) == []


@pytest.mark.parametrize(("degrees", "level"), [(3, "warning"), (-29, "refused"), (90, "refused")])
def test_a_yaw_is_named_with_its_size(degrees, level):
    ((found, cause, text),) = judged(noisy(PLACES_M) @ about_z(degrees).T)
    assert (found, cause) == (level, "yaw")
    assert abs(float(text.split("by ")[1].split("\xa0")[0]) - degrees) < 1.0


@pytest.mark.parametrize(
    ("shift_m", "words"),
    [((0, 0, 0.42), "0.42 m too low"), ((0, 0, -0.05), "m too high"), ((0.1, 0, 0), "m aside")],
)
def test_a_wrong_origin_is_named(shift_m, words):
    ((level, cause, text),) = judged(PLACES_M + np.array(shift_m))
    assert (level, cause) == ("refused", "origin")
    assert words in text.replace("0.420", "0.42")


def test_the_remedy_for_the_origin_is_right_under_a_yaw():
    frame = MocapFrame(yaw_deg=40.0, origin_m=(1.0, 2.0, 0.5))
    true = np.array([1.1, 1.8, 0.9])
    seen = PLACES_M @ about_z(-40.0).T + true  # in the file
    world = seen @ about_z(40.0).T - about_z(40.0) @ np.array(frame.origin_m)
    pose = rest_pose(dict(zip(MARKERS, world, strict=True)), META)
    (finding,) = judge_pose(pose, RecordingMap(frame=frame), "z")
    stated = [float(v) for v in finding.remedy.split("[")[1].split("]")[0].split(",")]
    assert stated == pytest.approx(true, abs=1e-3)


@pytest.mark.parametrize("axis", ["x", "y"])
def test_a_wrong_upward_axis_is_named(axis):
    order = {"x": [2, 0, 1], "y": [1, 2, 0]}[axis]
    ((level, cause, text),) = judged(PLACES_M[:, order])
    assert (level, cause) == ("refused", "up axis")
    assert f"is {axis}-up" in text


@pytest.mark.parametrize("pair", [(4, 5), (0, 2), (1, 13), (12, 15)])
def test_swapped_markers_are_named(pair):
    swapped = noisy(PLACES_M)
    swapped[list(pair)] = swapped[list(reversed(pair))]
    ((level, cause, text),) = judged(swapped)
    assert (level, cause) == ("refused", "swapped")
    assert all(MARKERS[k] in text for k in pair)


def test_rows_and_mirrored_corners_are_named():
    rows = noisy(PLACES_M).reshape(4, 4, 3)
    assert "rows" in judged(rows[[0, 2, 1, 3]].reshape(16, 3))[0][2]
    assert "corners" in judged(rows[:, [1, 0, 3, 2]].reshape(16, 3))[0][2]


def test_a_wrong_scale_is_named_also_where_the_pose_is_aligned():
    aligned = MocapFrame(align="rest")
    assert judged(1.1 * PLACES_M, aligned)[0][:2] == ("refused", "scale")
    assert judged(PLACES_M @ about_z(29).T, aligned) == []


def test_a_link_that_rests_at_an_angle_is_no_tilt():
    angle = np.array([0.2])
    turn = np.array([[np.cos(0.2), 0, np.sin(0.2)], [0, 1, 0], [-np.sin(0.2), 0, np.cos(0.2)]])
    named = dict(zip(MARKERS, PLACES_M @ turn.T, strict=True))
    assert judge_pose(rest_pose(named, META, angle), RecordingMap(), "z") == []
    assert judge_pose(rest_pose(named, META), RecordingMap(), "z")[0].cause == "tilt"


def test_reversed_rows_and_the_corners_of_one_row_are_named():
    reverse = [4 * (3 - k // 4) + k % 4 for k in range(16)]
    ((_, cause, text),) = judged(PLACES_M[reverse])
    assert cause == "swapped" and "rows" in text and "4, 3, 2, 1" in text
    turned = list(range(16))
    turned[8:12] = [9, 11, 8, 10]
    ((_, cause, text),) = judged(PLACES_M[turned])
    assert cause == "swapped" and text.startswith("corners of row 3")


@pytest.mark.parametrize("softer", [0.5, 2.0])
def test_the_sag_of_a_lying_link_is_no_tilt(softer):
    """Cantilever under its payload: it leans by 2 to 8° and is not refused."""
    lying = msgspec.structs.replace(META, payload_kg=0.5, gravity_m_s2=(-9.81, 0.0, 0.0))
    sunk_m = PLACES_M + softer * nominal_sag_m(lying, np.eye(3))

    def found(meta, align):
        pose = rest_pose(dict(zip(MARKERS, sunk_m, strict=True)), meta)
        mapping = RecordingMap(frame=MocapFrame(align=align))
        return [f.cause for f in judge_pose(pose, mapping, "z")]

    assert found(lying, "none") == []
    if softer > 1:  # an upright link does not lie like that
        assert found(META, "none")[0] == "tilt"
    assert found(lying, "rest") == ["sag"]  # which that alignment would erase


def test_base_markers_in_another_order_are_told_by_the_link_that_they_turn_over():
    def base(places_m):
        pose = rest_pose(dict(zip(MARKERS, places_m, strict=True)), META)
        return [f.cause for f in judge_base(pose)]

    assert base(noisy(PLACES_M)) == []
    assert base(PLACES_M * [1.0, -1.0, -1.0]) == base(PLACES_M @ about_z(90).T) == ["base"]


def test_mapped_markers_of_the_base_are_not_missed():
    names = (*MARKERS, "b01", "b02", "b03", "b04")
    columns = marker_columns({name: np.zeros((3, 3)) for name in names})
    series = Series(np.arange(3.0), columns, Path("take.csv"))
    mapping = RecordingMap(markers={name: name for name in names})
    assert judge_markers([series], mapping) == []


@pytest.mark.parametrize("gravity", [(0.0, 0.0, -9.81), (-9.81, 0.0, 0.0)])
@pytest.mark.parametrize("rows", [2, 3, 4])
def test_a_left_handed_file_mirrors_all_rows_however_few_there_are(rows, gravity):
    layout = square_layout(0.95, 0.15, rows=rows)
    meta = msgspec.structs.replace(META, markers=layout, gravity_m_s2=gravity)
    places_m = nominal_markers_m(meta) + nominal_sag_m(meta, np.eye(3))
    mirrored_m = noisy(places_m) * [1.0, -1.0, 1.0]
    pose = rest_pose(dict(zip(layout.names, mirrored_m, strict=True)), meta)
    found = judge_pose(pose, RecordingMap(), "z")
    (finding,) = found
    assert finding.level == "refused"
    assert finding.text.startswith("the file's axes are left-handed")
    assert "corners are named in the order 3, 4, 1, 2" in finding.text
    assert finding.remedy.startswith('set mirror = "y" under [frame]')


@pytest.mark.parametrize("pair", [(0, 4), (1, 2)])
def test_one_pair_of_two_rows_is_still_a_pair(pair):
    layout = square_layout(0.95, 0.15, rows=2)
    meta = msgspec.structs.replace(META, markers=layout)
    swapped = noisy(nominal_markers_m(meta))
    swapped[list(pair)] = swapped[list(reversed(pair))]
    found = rest_pose(dict(zip(layout.names, swapped, strict=True)), meta)
    assert found.order == " and ".join(layout.names[k] for k in pair) + " are swapped"
