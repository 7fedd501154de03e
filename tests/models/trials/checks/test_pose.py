"""Pose at rest: right ones pass, and remedies correct wrong ones (named in test_wrong_imports)."""

from pathlib import Path

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from firmware_py.link.marker_layout import square_layout
from models.trials.checks.markers import judge_markers
from models.trials.checks.pose import judge_base, judge_pose, nominal_sag_m, rest_pose
from models.trials.recordings.frames import nominal_markers_m, to_world
from models.trials.recordings.mapping import MocapFrame, RecordingMap
from models.trials.recordings.series import Series, marker_columns
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


def causes(*args, **options):
    return [f.cause for f in judged(*args, **options)[1]]


def noisy(places_m):
    """Markers are placed by hand, to a millimetre."""
    return places_m + 0.001 * np.random.default_rng(1).standard_normal(places_m.shape)


def proposed_origin_m(finding):
    return [float(v) for v in finding.remedy.split("[")[1].split("]")[0].split(",")]


def prebent(angle_rad):
    """Bend spread over the span as on the rig."""
    height_m = PLACES_M[:, 2] - 0.06
    return PLACES_M + np.outer(angle_rad * height_m**2 / (2 * 0.95), [1.0, 0, 0])


# --- right poses ----------------------------------------------------------------------------------


def test_a_right_pose_has_no_findings():
    occluded = noisy(PLACES_M)
    occluded[[2, 9]] = np.nan
    assert causes(occluded) == []
    pose, found = judged(prebent(0.02))
    assert found == [] and pose.tip_aside_m == pytest.approx(0.5 * 0.02 * 0.95, abs=1e-4)
    leaning = PLACES_M @ about("y", np.degrees(0.2)).T
    assert causes(leaning, rest_rad=np.array([0.2])) == []
    assert causes(leaning)[0] == "tilt"


@pytest.mark.parametrize("softer", [0.5, 2.0])
def test_the_sag_of_a_lying_link_is_no_tilt(softer):
    """Cantilever under its payload: it leans by 2 to 8°."""
    lying = msgspec.structs.replace(META, payload_kg=0.5, gravity_m_s2=LYING_M_S2)
    places_m = PLACES_M + softer * nominal_sag_m(lying, np.eye(3))
    assert causes(places_m, meta=lying) == []
    assert causes(places_m, MocapFrame(align="rest"), meta=lying) == ["sag"]  # it would remove it
    if softer > 1:
        assert causes(places_m)[0] == "tilt"  # an upright link does not lie like that


def test_markers_of_the_base_are_right_on_their_plate_and_not_missed_as_others():
    names = (*META.layout.names, "b01", "b02", "b03", "b04")
    columns = marker_columns({name: np.zeros((3, 3)) for name in names})
    mapping = RecordingMap(markers={name: name for name in names})
    assert judge_markers([Series(np.arange(3.0), columns, Path("take.csv"))], mapping) == []
    assert judge_base(judged(noisy(PLACES_M))[0]) == []
    for places_m in (PLACES_M * [1.0, -1.0, -1.0], PLACES_M @ about("z", 90).T):
        assert [f.cause for f in judge_base(judged(places_m)[0])] == ["base"]


# --- left-handed files ----------------------------------------------------------------------------


@pytest.mark.parametrize(("axis", "up"), [("x", "z"), ("y", "y"), ("z", "y")])
def test_the_remedy_for_a_left_handed_file_corrects_it(axis, up):
    """The marker names are right: the map must not exchange them."""
    right_handed = PLACES_M if up == "z" else PLACES_M[:, [0, 2, 1]] * [1, 1, -1]
    left_handed = right_handed * [-1.0 if a == axis else 1.0 for a in "xyz"]
    finding = judged(left_handed, MocapFrame(up=up))[1][0]
    assert finding.cause == "swapped" and f'mirror = "{axis}"' in finding.remedy
    pose, found = judged(left_handed, MocapFrame(up=up, mirror=axis))
    assert found == [] and pose.measured_m == pytest.approx(PLACES_M)


@pytest.mark.parametrize(("rows", "gravity"), [(2, (0.0, 0.0, -9.81)), (3, LYING_M_S2)])
def test_a_left_handed_file_of_few_rows_is_recognised(rows, gravity):
    layout = square_layout(0.95, 0.15, rows=rows)
    meta = msgspec.structs.replace(META, markers=layout, gravity_m_s2=gravity)
    places_m = nominal_markers_m(meta) + nominal_sag_m(meta, np.eye(3))
    _, (finding,) = judged(noisy(places_m) * [1.0, -1.0, 1.0], meta=meta)
    assert "left-handed" in finding.text and 'mirror = "y"' in finding.remedy
    swapped = noisy(places_m)
    swapped[[0, 4]] = swapped[[4, 0]]  # one pair is no mirror
    one, other = layout.names[0], layout.names[4]
    assert f"{one} and {other} are swapped" in judged(swapped, meta=meta)[1][0].text


def test_exchanged_axes_are_corrected_in_two_steps():
    in_file = PLACES_M[:, [1, 0, 2]]
    axis = judged(in_file)[1][0].remedy.split('"')[1]
    _, (second,) = judged(in_file, MocapFrame(mirror=axis))
    yaw_deg = float(second.remedy.split("yaw_deg = ")[1].split()[0])
    pose, found = judged(in_file, MocapFrame(mirror=axis, yaw_deg=yaw_deg))
    assert found == [] and pose.measured_m == pytest.approx(PLACES_M, abs=1e-9)


# --- frame and origin -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("places_m", "frame", "level", "cause", "words"),
    [
        (PLACES_M @ about("y", -4).T, {}, "warning", "tilt", "its tip 70\xa0mm aside"),
        (PLACES_M, {"mirror": "x"}, "refused", "swapped", 'with mirror = "x"'),
        # An origin that hides the tilt at the lowest row.
        (PLACES_M @ about("y", 1.9).T, {"origin_m": (0.01, 0, 0)}, "warning", "tilt", ""),
        (1.1 * PLACES_M, {"align": "rest"}, "refused", "scale", ""),  # alignment does not scale
    ],
)
def test_a_wrong_frame_is_named_with_its_size(places_m, frame, level, cause, words):
    _, (finding,) = judged(places_m, MocapFrame(**frame))
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


def test_a_tilt_beside_a_wrong_origin_does_not_change_the_proposed_origin():
    _, (tilt, origin) = judged(PLACES_M @ about("y", 1.9).T + [0, 0, 0.05])
    assert (tilt.cause, origin.cause) == ("tilt", "origin")
    assert proposed_origin_m(origin) == pytest.approx([0, 0, 0.05], abs=1e-3)
    _, (tilt, origin) = judged((PLACES_M - [0, 0, 0.6]) @ about("y", 1.9).T + [0, 0, 0.6])
    assert tilt.cause == "tilt" and "correct the tilt first" in origin.remedy
