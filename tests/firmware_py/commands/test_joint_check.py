"""Joints that a hand turns, in simulated time and through the command."""

import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.commands.doctor import PATIENCE_S, turn_joints
from firmware_py.core.errors import InputError
from firmware_py.system.clock import SimClock


class Hand:
    """A bus whose servos a hand turns, some seconds after each request."""

    dof = 2

    def __init__(self, servo_of_joint=(0, 1), turn_rad=0.2, unread=()):
        self.clock = SimClock()
        self.angle_rad = np.array([0.3, -0.1])
        self._wiring, self._turn_rad, self._unread = servo_of_joint, turn_rad, unread
        self._asked_ns, self._joint, self.reads = None, -1, 0
        self.requests = []

    def ask(self, request):
        self.requests.append(request)
        self._joint += 1
        self._asked_ns = self.clock.now_ns()

    def read(self, deadline_ns):
        self.reads += 1
        if self.reads in self._unread:
            return BusStatus.TIMEOUT
        if self._asked_ns is not None:
            since_s = (self.clock.now_ns() - self._asked_ns) * 1e-9
            turned = np.clip((since_s - 2.0) / 4.0, 0.0, 1.0)  # and it moves on after 5 degrees
            own = self._wiring[self._joint]
            self.angle_rad[own] = (0.3, -0.1)[own] + self._turn_rad * turned
        return BusStatus.OK


def test_each_joint_is_found_where_the_ids_are_right():
    hand = Hand(unread=range(5, 90, 7))
    turns = turn_joints(hand, hand.clock, 0.008, hand.ask)
    assert [(t.joint, t.found) for t in turns] == [(1, 1), (2, 2)]
    assert all(0.087 <= t.change_rad < 0.2 for t in turns)
    assert "its angle changed by" in turns[1].sentence((4, 7))
    assert turns[1].sentence((4, 7)).endswith("(servo 7)")
    assert [r[:12] for r in hand.requests] == ["turn joint 1", "turn joint 2"]


def test_exchanged_ids_are_told_with_the_sign_of_the_turn():
    hand = Hand(servo_of_joint=(1, 0), turn_rad=-0.2)
    turns = turn_joints(hand, hand.clock, 0.008, hand.ask)
    assert [(t.joint, t.found) for t in turns] == [(1, 2), (2, 1)]
    told = turns[0].sentence((4, 7))
    assert all(word in told for word in ("joint 1", "joint 2 (servo 7)", "-5.", "[[servos]]"))


def test_a_hand_that_turns_too_little_and_servos_that_say_nothing_are_refused():
    hand = Hand(turn_rad=0.05)
    with pytest.raises(InputError, match="saw no joint turn by 5"):
        turn_joints(hand, hand.clock, 0.008, hand.ask)
    assert hand.clock.now_ns() >= PATIENCE_S * 1e9
    silent = Hand(unread=range(1, 10**6))
    with pytest.raises(InputError, match="no second in which the joints stand still"):
        turn_joints(silent, silent.clock, 0.008, silent.ask)


@pytest.mark.parametrize(
    "words", [["--check-joints"], ["--check-joints", "--bus", "--config", "robot.toml"]]
)
def test_the_check_wants_its_robot_and_nothing_else(words, capsys):
    assert main(["doctor", "--check-joints", *words]) == 2
    assert "--check-joints" in capsys.readouterr().err
