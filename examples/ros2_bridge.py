"""Bridge between ROS 2 and the robot: topics instead of the socket's messages.

| topic | type | direction |
|---|---|---|
| `joint_goals` | std_msgs/Float64MultiArray, rad | to the robot |
| `tip_goals` | geometry_msgs/Point, m | to the robot |
| `joint_states` | sensor_msgs/JointState | from the robot |
| `tip` | geometry_msgs/PointStamped | from the robot |

Goals may arrive at any time and rate: in every tick the bridge moves towards the latest, at most at
`--rate` rad/s or `--speed` m/s. ROS 2 is not a dependency; rclpy is imported when the bridge
starts:

    python examples/ros2_bridge.py --goals unix:/run/dropstitch/goals
"""

from __future__ import annotations

import argparse
import importlib
import socket
import sys
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from firmware_py.core.signals import PERIOD_S
from firmware_py.goals.goal_channel import GoalMessage, StatusMessage, connect, encode_goal

Array = NDArray[np.float64]


class GoalFollower:
    """Goals that move towards the latest request at a limited rate.

    `rate_rad_s`, `speed_m_s`: largest rate of joint goals and largest speed of tip goals.
    """

    def __init__(self, rate_rad_s: float, speed_m_s: float, period_s: float = PERIOD_S) -> None:
        self._steps = {"joint_rad": rate_rad_s * period_s, "tip_m": speed_m_s * period_s}
        self._kind, self._wanted = "joint_rad", np.zeros(0)
        self._at: Array | None = None

    def want(self, kind: str, values: Sequence[float]) -> None:
        """Set the goals to move to; `kind` is "joint_rad" or "tip_m"."""
        if kind != self._kind:
            self._at = None
        self._kind, self._wanted = kind, np.array(values, dtype=np.float64)

    def answer(self, status: StatusMessage) -> GoalMessage:
        dof = len(status.goal_rad)
        if self._at is None:
            start = status.goal_rad if self._kind == "joint_rad" else status.tip_m[:dof]
            self._at = np.array(start)
        if len(self._wanted) >= dof:
            most = self._steps[self._kind]
            way = self._wanted[:dof] - self._at
            self._at = self._at + way * min(1.0, most / max(float(np.abs(way).max()), 1e-12))
        own = tuple(self._at.tolist())
        if self._kind == "joint_rad":
            return GoalMessage(status.tick, joint_rad=own)
        return GoalMessage(status.tick, tip_m=own)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the bridge until the robot stops."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--goals", required=True, metavar="unix:PATH", help="socket of the robot")
    parser.add_argument("--rate", type=float, default=0.5, help="of joint goals, rad/s (0.5)")
    parser.add_argument("--speed", type=float, default=0.3, help="of the tip, m/s (0.3)")
    args = parser.parse_args(argv)
    try:
        rclpy = importlib.import_module("rclpy")
    except ImportError:
        print("the bridge needs rclpy: source the set-up file of ROS 2", file=sys.stderr)
        return 2
    try:
        connection = connect(args.goals)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    with connection:
        return _bridge(rclpy, connection, GoalFollower(args.rate, args.speed))


def _bridge(rclpy: Any, connection: socket.socket, follower: GoalFollower) -> int:
    geometry, sensor, std = (
        importlib.import_module(f"{name}_msgs.msg") for name in ("geometry", "sensor", "std")
    )
    rclpy.init()
    node = rclpy.create_node("dropstitch")
    node.create_subscription(
        std.Float64MultiArray, "joint_goals", lambda m: follower.want("joint_rad", m.data), 1
    )
    node.create_subscription(
        geometry.Point, "tip_goals", lambda m: follower.want("tip_m", (m.x, m.y)), 1
    )
    states = node.create_publisher(sensor.JointState, "joint_states", 1)
    tips = node.create_publisher(geometry.PointStamped, "tip", 1)
    try:
        while data := connection.recv(4096):
            status = msgspec.json.decode(data, type=StatusMessage)
            rclpy.spin_once(node, timeout_sec=0.0)
            connection.send(encode_goal(follower.answer(status)))
            stamp = node.get_clock().now().to_msg()
            state, tip = sensor.JointState(), geometry.PointStamped()
            state.header.stamp = tip.header.stamp = stamp
            tip.header.frame_id = "world"
            state.name = [f"joint_{j + 1}" for j in range(len(status.angle_rad))]
            state.position = list(status.angle_rad)
            tip.point.x, tip.point.y, tip.point.z = status.tip_m
            states.publish(state)
            tips.publish(tip)
    except ConnectionError:
        pass  # the robot has stopped
    finally:
        node.destroy_node()
        rclpy.shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
