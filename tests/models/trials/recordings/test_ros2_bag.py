import numpy as np
import pytest
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore

from models.trials.files import read_trial

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
    names = ["wrist", "base", "tilt"] if session.dof == 2 else ["base", "wrist"]
    order = [names.index(n) for n in ("base", "tilt")[: session.dof]]
    messages = []
    for t, angle, current in zip(
        session.servo_true_s, session.angle_rad, session.current_a, strict=True
    ):
        full, amps = np.full(len(names), 9.0), np.full(len(names), 9.0)
        full[order], amps[order] = angle, 1e3 * current
        messages.append((t, "/joint_states", joint_state(t, full, amps, names)))
        messages.append((t, "/goals", joint_state(t, full, [], names)))
    for t, row in zip(session.mocap_s, session.markers_m, strict=True):
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


@pytest.mark.parametrize("form", ["MarkerArray", "PoseArray"])
def test_a_bag_becomes_the_true_trial(session, write_map, run, check, tmp_path, form):
    bag = write_bag(tmp_path / "bag", session, form)
    settings = {"topics": TOPICS, "joints": ["base", "tilt"][: session.dof], "effort_unit": "mA"}
    if form == "MarkerArray":
        settings["markers"] = {f"m{i:02d}": f"m{i}" for i in range(1, 17)}
    else:
        settings["topics"] = TOPICS | {"/tip": "tip"}
    map_ = write_map(session.dof, **settings)
    code, _, err = run(bag, "--as", "rosbag", "--map", map_)
    assert code == 0, err
    trial = read_trial(tmp_path / "trials" / "bag.csv")
    check(trial, session.servo_true_s[0], session.dof, 3e-4)


def test_wrong_bags_and_topics_get_one_sentence(session, write_map, refused, tmp_path):
    bag = write_bag(tmp_path / "bag", session, "PoseArray")

    def sentence(topics, **settings):
        map_ = write_map(session.dof, topics=topics, **settings)
        return refused(bag, "--as", "rosbag", "--map", map_)

    assert "names no topics" in sentence({})
    assert "topic /js is missing; it has /goals, /joint_states" in sentence({"/js": "joints"})
    assert "cannot be read as 'tip'" in sentence({"/joint_states": "tip"})
    assert "has no joint 'elbow'" in sentence({"/joint_states": "joints"}, joints=["elbow"])
    units = {"joints": ["base", "tilt"][: session.dof], "effort_unit": "mA"}
    assert "nothing holds goal_1_rad" in sentence({"/joint_states": "joints"}, **units)
    (tmp_path / "empty").mkdir()
    map_ = write_map(session.dof, topics=TOPICS)
    assert "is no readable ROS 2 bag" in refused(
        tmp_path / "empty", "--as", "rosbag", "--map", map_
    )
