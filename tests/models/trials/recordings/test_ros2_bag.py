import numpy as np
import pytest
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
T = STORE.types
EPOCH_S = 1_700_000_000
TOPICS = {"/joint_states": "joints", "/goals": "goals", "/markers": "markers"}


def header(time_s):
    whole = int(np.floor(time_s))
    stamp = T["builtin_interfaces/msg/Time"](EPOCH_S + whole, int((time_s - whole) * 1e9))
    return T["std_msgs/msg/Header"](stamp=stamp, frame_id="mocap")


def point(p):
    return T["geometry_msgs/msg/Point"](*map(float, p))


def pose(p):
    return T["geometry_msgs/msg/Pose"](
        point(p), T["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    )


def joint_state(time_s, angle, current, names):
    none = np.zeros(0)
    return T["sensor_msgs/msg/JointState"](
        header(time_s), names, np.array(angle, float), none, np.array(current, float)
    )


def marker_array(time_s, row):
    kind = T["visualization_msgs/msg/Marker"]
    rgba = T["std_msgs/msg/ColorRGBA"](0.0, 0.0, 0.0, 0.0)
    still = T["builtin_interfaces/msg/Duration"](0, 0)
    size = T["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    image = T["sensor_msgs/msg/CompressedImage"](header(0), "", np.zeros(0, np.uint8))
    mesh = T["visualization_msgs/msg/MeshFile"]("", np.zeros(0, np.uint8))
    return T["visualization_msgs/msg/MarkerArray"]([
        kind(header(time_s), "m", i, 0, 0, pose(p), size, rgba, still, False, [], [], "", image,
             [], "", "", mesh, False)
        for i, p in enumerate(row, start=1)
    ])  # fmt: skip


def write_bag(path, session, form):
    """A bag in which nothing is recorded at the moment it was stamped."""
    names, messages = ["wrist", "base", "tilt"], []
    for t, angle, current in zip(
        session.servo_true_s, session.angle_rad, session.current_a, strict=True
    ):
        full, amps = np.append(9.0, angle), np.append(9.0, 1e3 * current)
        messages.append((t, "/joint_states", joint_state(t, full, amps, names)))
        messages.append((t, "/goals", joint_state(t, full, [], names)))
    for t, row in zip(session.mocap_s, session.markers_m, strict=False):
        if form == "MarkerArray":
            messages.append((t, "/markers", marker_array(t, row)))
        else:
            array = T["geometry_msgs/msg/PoseArray"](header(t), [pose(p) for p in row])
            messages.append((t, "/markers", array))
        tip = T["geometry_msgs/msg/PointStamped"](header(t), point(row[12:].mean(axis=0)))
        messages.append((t, "/tip", tip))
    with Writer(path, version=9) as bag:
        connections = {}
        for t, topic, message in messages:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=STORE)
            recorded_ns = int((EPOCH_S + t) * 1e9) + 30_000_000
            bag.write(connections[topic], recorded_ns, STORE.serialize_cdr(message, kind))
    return path


@pytest.mark.slow
@pytest.mark.parametrize("form", ["MarkerArray", "PoseArray"])
def test_a_bag_becomes_the_true_trial(session, write_map, run, check, tmp_path, form):
    bag = write_bag(tmp_path / "bag", session, form)
    tables = {"topics": TOPICS | {"/tip": "tip"}}
    if form == "MarkerArray":
        tables = {"topics": TOPICS, "markers": {f"m{i:02d}": f"m{i}" for i in range(1, 17)}}
    map_ = write_map(joints=["base", "tilt"], effort_unit="mA", **tables)
    code, _, err = run(bag, "--as", "rosbag", "--map", map_)
    assert code == 0, err
    check(tmp_path / "trials" / "bag.csv", session.first_s)


def test_wrong_bags_and_topics_are_refused_by_their_fault(session, write_map, refused, tmp_path):
    session.mocap_s = session.mocap_s[:20]
    write_bag(tmp_path / "bag", session, "PoseArray")
    (tmp_path / "empty").mkdir()
    joints = {"/joint_states": "joints"}
    units = {"joints": ["base", "tilt"], "effort_unit": "mA"}
    for bag, words, tables in (
        ("bag", "names no topics", {}),
        ("bag", "topic /js is missing; it has /goals, /joint", {"topics": {"/js": "joints"}}),
        ("bag", "cannot be read as 'tip'", {"topics": {"/joint_states": "tip"}}),
        ("bag", "has no joint 'elbow'", {"topics": joints, "joints": ["elbow"]}),
        ("bag", "nothing holds goal_1_rad", {"topics": joints} | units),
        ("empty", "is no readable ROS 2 bag", {"topics": TOPICS}),
    ):
        map_ = write_map(**tables)
        assert words in refused(tmp_path / bag, "--as", "rosbag", "--map", map_)
