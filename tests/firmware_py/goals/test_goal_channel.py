"""Socket between robot and program, the example client, the map's document."""

import contextlib
import socket
import subprocess
import sys
import threading

import msgspec
import numpy as np
import pytest

from firmware_py.core.documents import write_document
from firmware_py.core.errors import InputError
from firmware_py.goals.goal_channel import SocketChannel, accepted_program, connect
from firmware_py.goals.goal_map import RestGoals, read_goal_map
from firmware_py.goals.outside_goals import ZeroVibration
from firmware_py.summary import Ended
from tests.firmware_py.goals.scripted_program import linear_map, run


@pytest.fixture
def pair():
    ends = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    yield ends
    for end in ends:
        end.close()


def test_messages_stay_apart_and_a_closed_side_is_seen(pair):
    channel = SocketChannel(pair[0])
    assert channel.receive(5) == []
    for k in range(3):
        pair[1].send(b"%d" % k)
    assert channel.receive(2) == [b"0", b"1"]
    assert channel.receive(5) == [b"2"]
    channel.send(b"status")
    assert pair[1].recv(100) == b"status"
    pair[1].close()
    assert (channel.receive(5), channel.gone) == ([], True)
    channel.send(b"nobody")


def test_a_program_that_does_not_read_blocks_nothing(pair):
    channel = SocketChannel(pair[0])
    for _ in range(5000):
        channel.send(b"x" * 200)
    assert not channel.gone


def test_one_program_connects_and_the_path_is_gone_afterwards(tmp_path):
    address, path = f"unix:{tmp_path}/goals", tmp_path / "goals"
    ends = []

    def program():
        while not ends:
            with contextlib.suppress(InputError):
                ends.append(connect(address))

    thread = threading.Thread(target=program)
    thread.start()
    with accepted_program(address, 10.0) as channel:
        thread.join()
        assert not path.exists()
        with pytest.raises(InputError, match="no robot listens there"):
            connect(address)
        ends[0].send(b"hello")
        assert channel.receive(1) == [b"hello"]
    assert ends[0].recv(10) == b""
    ends[0].close()


def test_addresses_that_cannot_be_are_refused(tmp_path, capsys):
    def open_(address):
        with accepted_program(address, 0.01):
            pass

    for address, sentence in (
        ("/tmp/x", "give unix:PATH"),
        (f"unix:{tmp_path}/no/goals", "cannot be opened"),
        (f"unix:{tmp_path}/{'x' * 200}", "cannot be opened"),
        (f"unix:{tmp_path}/goals", "no program connected"),
    ):
        with pytest.raises(InputError, match=sentence):
            open_(address)
        waiting = f"waiting at {address} " in capsys.readouterr().err
        assert waiting is (sentence == "no program connected")
    old = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    old.bind(str(tmp_path / "goals"))
    with pytest.raises(InputError, match="no program connected"):
        open_(f"unix:{tmp_path}/goals")
    old.close()
    (tmp_path / "file").write_text("mine")
    with pytest.raises(InputError, match="cannot be opened"):
        open_(f"unix:{tmp_path}/file")
    assert (tmp_path / "file").read_text() == "mine"


def test_the_example_client_leads_the_tip_once_around(tmp_path):
    address = f"unix:{tmp_path}/goals"
    client = subprocess.Popen([sys.executable, "docs/tip/goal_client.py", str(tmp_path / "goals")])
    with accepted_program(address, 20.0, patience_s=5.0) as channel:
        summary, *_ = run(channel, goal_map=linear_map(2), dof=2, slots=2000, payload_kg=0.0)
    assert client.wait(10) == 0
    assert summary.ended is Ended.FINISHED
    assert summary.reason.endswith("has ended the run")
    goals = np.column_stack([summary.records[f"goal_{j}_rad"] for j in (1, 2)])
    assert goals.max(axis=0) == pytest.approx([0.1, 0.2], abs=2e-3)


def test_a_map_is_interpolated_and_read_as_it_was_written(tmp_path):
    goal_map = linear_map(2)
    write_document(tmp_path / "map.json", goal_map)
    assert read_goal_map(tmp_path / "map.json") == goal_map
    rest = RestGoals(goal_map)
    assert rest.goals_rad((0.13, -0.21), 0.0) == pytest.approx([0.13, -0.21])
    assert rest.goals_rad((0.13, -0.21), 1.0) == pytest.approx([0.195, -0.315])
    assert rest.goals_rad((0.5, 0.5), 9.0) == pytest.approx([1.0, 1.0])
    assert rest.goals_rad((0.51, 0.0), 1.0) is None
    assert rest.mode(1.0) == ([0.17, 0.17], [0.8, 0.8])


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"dof": 3}, "3 joints"),
        ({"dof": 2}, "needs 2 columns of 121 goals"),
        ({"places_m": (0.0, 0.1, 0.3)}, "do not rise evenly"),
        ({"places_m": (0.0,)}, "needs 2 to 201"),
        ({"payloads": ()}, "or none"),
    ],
)
def test_a_map_that_cannot_be_is_refused(tmp_path, change, sentence):
    write_document(tmp_path / "map.json", msgspec.structs.replace(linear_map(1), **change))
    with pytest.raises(InputError, match=sentence):
        read_goal_map(tmp_path / "map.json")


def test_the_shaper_cancels_the_mode_also_between_two_ticks():
    """The response of a damped oscillator to a shaped step, by its exact convolution."""
    period_s, half_s, decay = 0.001, 0.2503, 0.75
    shaper = ZeroVibration([0.0], 0.3, period_s)
    sent = np.array([shaper.next([1.0], [half_s], [decay])[0] for _ in range(900)])
    pole = complex(np.log(decay) / half_s, np.pi / half_s)
    at_s = period_s * np.arange(900)
    steps = np.diff(sent, prepend=0.0)
    assert abs(np.sum(steps * np.exp(-pole * at_s))) < 1e-3
