"""Doctor: checks on machines made of files, and joints that a hand turns in simulated time."""

import numpy as np
import pytest

from firmware_py.bus.servo_bus import BusStatus
from firmware_py.commands.doctor import PATIENCE_S, turn_joints
from firmware_py.commands.doctor_checks import Severity, examine
from firmware_py.core.errors import InputError
from firmware_py.system.clock import SimClock


def machine(tmp_path, **files):
    for name, content in files.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content + "\n", encoding="utf-8")
    return tmp_path


LATENCY = "sys/bus/usb-serial/devices/ttyUSB0/latency_timer"
GOVERNOR = "sys/devices/system/cpu/cpu{}/cpufreq/scaling_governor"
CLOCK = "sys/devices/system/clocksource/clocksource0/current_clocksource"


def verdict(root, name, granted=True):
    return {f.name: f for f in examine(root, lambda: granted)}[name]


@pytest.mark.parametrize(
    ("name", "files", "expected"),
    [
        ("USB latency timer", {}, Severity.UNCHECKED),
        ("USB latency timer", {LATENCY: "1"}, Severity.GOOD),
        ("USB latency timer", {LATENCY: "2"}, Severity.SPOILS),
        ("USB latency timer", {LATENCY: "16"}, Severity.SPOILS),
        ("USB latency timer", {LATENCY: "1", LATENCY.replace("B0", "B1"): "16"}, Severity.SPOILS),
        ("swap", {"proc/swaps": "Filename Type Size"}, Severity.GOOD),
        ("swap", {"proc/swaps": "Filename Type Size\n/dev/sda2 partition 1"}, Severity.NOTE),
        ("swap", {}, Severity.UNCHECKED),
        ("frequency governor", {GOVERNOR.format(0): "performance"}, Severity.GOOD),
        (
            "frequency governor",
            {GOVERNOR.format(0): "performance", GOVERNOR.format(1): "powersave"},
            Severity.NOTE,
        ),
        ("clock source", {CLOCK: "tsc"}, Severity.GOOD),
        ("clock source", {CLOCK: "hpet"}, Severity.SPOILS),
        ("kernel preemption", {"proc/version": "Linux #1 SMP PREEMPT_RT"}, Severity.GOOD),
        ("kernel preemption", {"proc/version": "Linux #1 SMP"}, Severity.NOTE),
    ],
)
def test_each_finding_follows_its_file(tmp_path, name, files, expected):
    finding = verdict(machine(tmp_path, **files), name)
    assert finding.verdict is expected
    assert bool(finding.remedy) is (expected is not Severity.GOOD)


def test_rights_and_the_adapter_at_fault_are_named(tmp_path):
    for granted, expected in ((True, Severity.GOOD), (False, Severity.SPOILS)):
        assert verdict(tmp_path, "scheduler rights", granted).verdict is expected
    finding = verdict(machine(tmp_path, **{LATENCY: "16"}), "USB latency timer")
    assert finding.found == "ttyUSB0 16 ms"
    assert "ttyUSB0/latency_timer" in finding.remedy


# --- joints that a hand turns, in simulated time and through the command ------------------------


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
            servo = self._wiring[self._joint]
            self.angle_rad[servo] = (0.3, -0.1)[servo] + self._turn_rad * turned
        return BusStatus.OK


def test_each_joint_is_confirmed_where_the_ids_are_right():
    hand = Hand(unread=range(5, 90, 7))
    turns = turn_joints(hand, hand.clock, 0.008, hand.ask)
    assert [(t.joint, t.turned) for t in turns] == [(1, 1), (2, 2)]
    assert all(0.087 <= t.change_rad < 0.2 for t in turns)
    assert "its angle changed by" in turns[1].sentence((4, 7))
    assert turns[1].sentence((4, 7)).endswith("(servo 7)")
    assert [r[:12] for r in hand.requests] == ["turn joint 1", "turn joint 2"]


def test_exchanged_ids_are_reported_with_the_sign_of_the_turn():
    hand = Hand(servo_of_joint=(1, 0), turn_rad=-0.2)
    turns = turn_joints(hand, hand.clock, 0.008, hand.ask)
    assert [(t.joint, t.turned) for t in turns] == [(1, 2), (2, 1)]
    sentence = turns[0].sentence((4, 7))
    assert all(word in sentence for word in ("joint 1", "joint 2 (servo 7)", "-5.", "[[servos]]"))


def test_a_turn_that_is_too_small_and_servos_that_do_not_answer_are_refused():
    hand = Hand(turn_rad=0.05)
    with pytest.raises(InputError, match="saw no joint turn by 5"):
        turn_joints(hand, hand.clock, 0.008, hand.ask)
    assert hand.clock.now_ns() >= PATIENCE_S * 1e9
    silent = Hand(unread=range(1, 10**6))
    with pytest.raises(InputError, match="no second in which the joints stand still"):
        turn_joints(silent, silent.clock, 0.008, silent.ask)
