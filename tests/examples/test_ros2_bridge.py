"""ROS 2 bridge against a stand-in: goals at a limited rate, every status answered and published."""

import socket
import sys
import types

import msgspec
import pytest

from examples import ros2_bridge
from examples.ros2_bridge import GoalFollower
from firmware_py.goals import goal_channel
from firmware_py.goals.goal_channel import (
    StatusMessage,
    encode_status,
)


@pytest.fixture
def pair():
    ends = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    yield ends
    for end in ends:
        end.close()


def status(tick, goal=(0.0,), tip=(0.01, 0.0, 1.0)):
    return StatusMessage(tick, 0.0, "RUNNING", goal, goal, tip, True, None)


def test_the_bridge_goes_towards_the_latest_goals_at_a_limited_rate():
    follower = GoalFollower(0.5, 0.3, period_s=0.1)
    assert follower.answer(status(1, (0.2,))).joint_rad == (0.2,)
    follower.want("joint_rad", [0.3])
    assert [follower.answer(status(k)).joint_rad[0] for k in (2, 3, 4)] == pytest.approx(
        [0.25, 0.3, 0.3]
    )
    follower.want("tip_m", (0.03, 0.0))
    answer = follower.answer(status(5))
    assert (answer.tick, answer.joint_rad) == (5, None)
    assert answer.tip_m == pytest.approx((0.03,))


class FakeRos:
    """What the bridge calls of rclpy, without ROS 2."""

    def __init__(self):
        self.published, self.callbacks, self.spins = [], {}, 0

    def init(self):
        pass

    shutdown = init

    def create_node(self, name):
        stamp = types.SimpleNamespace(to_msg=lambda: "now")
        return types.SimpleNamespace(
            create_subscription=lambda kind, topic, call, depth: self.callbacks.update(
                {topic: call}
            ),
            create_publisher=lambda kind, topic, depth: types.SimpleNamespace(
                publish=lambda message: self.published.append((topic, message))
            ),
            get_clock=lambda: types.SimpleNamespace(now=lambda: stamp),
            destroy_node=lambda: None,
        )

    def spin_once(self, node, timeout_sec):
        self.spins += 1
        self.callbacks["joint_goals"](types.SimpleNamespace(data=[0.004]))


def message():
    header = types.SimpleNamespace(stamp=None, frame_id="")
    return types.SimpleNamespace(header=header, point=types.SimpleNamespace())


def test_the_bridge_answers_every_status_and_publishes_it(pair, monkeypatch):
    ros = FakeRos()
    kinds = {"geometry_msgs.msg": ("PointStamped", "Point"), "sensor_msgs.msg": ("JointState",)}
    kinds["std_msgs.msg"] = ("Float64MultiArray",)
    for name, own in kinds.items():
        module = types.SimpleNamespace(**dict.fromkeys(own, message))
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setitem(sys.modules, "rclpy", ros)
    monkeypatch.setattr(ros2_bridge, "connect", lambda address: pair[0])
    for tick in (1, 2):
        pair[1].send(encode_status(status(tick)))
    pair[1].shutdown(socket.SHUT_WR)
    assert ros2_bridge.main(["--goals", "unix:/x"]) == 0
    answers = [msgspec.json.decode(pair[1].recv(500)) for _ in range(2)]
    assert answers == [{"tick": 1, "joint_rad": [0.004]}, {"tick": 2, "joint_rad": [0.004]}]
    assert [topic for topic, _ in ros.published] == ["joint_states", "tip"] * 2
    assert ros.published[1][1].point.x == 0.01


def test_the_bridge_says_what_is_missing(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "rclpy", None)
    assert ros2_bridge.main(["--goals", "unix:/x"]) == 2
    assert "source the set-up file of ROS 2" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "rclpy", FakeRos())
    assert ros2_bridge.main(["--goals", "unix:/nowhere"]) == 2
    assert goal_channel.PREFIX in capsys.readouterr().err
