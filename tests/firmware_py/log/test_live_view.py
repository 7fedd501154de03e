"""Live view through a real WebSocket, and a loop that neither viewer nor recorder can delay.

Viewers and recorder are separate processes here, killed and stopped by signals.
"""

import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from firmware_py.core.errors import InputError
from firmware_py.log.live_gate import LiveGate
from firmware_py.log.recorder import recording
from firmware_py.log.recording import SCHEMA_NAME, TOPIC, read_recording, tick_schema
from firmware_py.log.sinks import LiveConfig
from firmware_py.summary import Ended
from tests.firmware_py.log.test_recorder import ROOT, assert_same, put_all, ticks
from tests.firmware_py.simulated_loop import make

ANYWHERE = LiveConfig(port=0)
ORIGINS = LiveConfig().origins
PATIENCE_S = 30


def url_of(capfd):
    """Where the recorder says that it serves."""
    return re.search(r"ws://127\.0\.0\.1:\d+", capfd.readouterr().err).group()


@contextlib.contextmanager
def subscribed(url):
    """A connection that has asked for the ticks, and what the server said about them."""
    with connect(url, subprotocols=["foxglove.sdk.v1"]) as viewer:
        assert json.loads(viewer.recv(PATIENCE_S))["name"] == "dropstitch"
        (channel,) = json.loads(viewer.recv(PATIENCE_S))["channels"]
        wish = {"op": "subscribe", "subscriptions": [{"id": 1, "channelId": channel["id"]}]}
        viewer.send(json.dumps(wish))
        yield viewer, channel


def tick_of(packet):
    """Wall time and content of a message, Foxglove's binary frame taken off."""
    assert packet[0] == 1
    return int.from_bytes(packet[5:13], "little"), json.loads(packet[13:])


def until_seen(viewer, telemetry, record):
    """Send a record again and again: the server begins to send some time after it was asked."""
    while True:
        telemetry.put(memoryview(record.tobytes()))
        with contextlib.suppress(TimeoutError):
            return viewer.recv(0.05)


def test_a_viewer_sees_every_tick_with_its_schema(tmp_path, capfd):
    records = ticks(200)
    with (
        recording(None, 2, 10**18, {}, live=ANYWHERE) as telemetry,
        subscribed(url_of(capfd)) as (viewer, channel),
    ):
        assert (channel["topic"], channel["schemaName"]) == (TOPIC, SCHEMA_NAME)
        assert (channel["encoding"], channel["schemaEncoding"]) == ("json", "jsonschema")
        assert json.loads(channel["schema"]) == tick_schema(2)
        first = records[0].copy()
        first["tick"] = -1
        assert tick_of(until_seen(viewer, telemetry, first))[1]["tick"] == -1
        put_all(telemetry, records)
        seen = []
        while len(seen) < len(records):
            seen.append(tick_of(viewer.recv(PATIENCE_S)))
            if seen[-1][1]["tick"] == -1:
                seen.pop()  # what was sent twice to begin with
    assert [time_ns for time_ns, _ in seen] == [
        10**18 + round(time_s * 1e9) for time_s in records["time_s"]
    ]
    for name in ("tick", "angle_1_rad", "current_2_a", "busy_ns"):
        assert [tick[name] for _, tick in seen] == records[name].tolist()
    assert not list(tmp_path.iterdir())


VIEWER = """
import sys
from tests.firmware_py.log.test_live_view import subscribed
with subscribed(sys.argv[1]) as (viewer, _):
    viewer.recv()
    print("looks", flush=True)
    while True:
        viewer.recv()
"""


@pytest.mark.slow
@pytest.mark.parametrize("fate", [signal.SIGKILL, signal.SIGSTOP])
def test_a_viewer_that_dies_or_stands_still_costs_the_log_nothing(tmp_path, capfd, fate):
    records, path = ticks(3000), tmp_path / "run.mcap"
    with recording(path, 2, 10**18, {}, live=ANYWHERE) as telemetry:
        viewer = subprocess.Popen(
            [sys.executable, "-c", VIEWER, url_of(capfd)], cwd=ROOT, stdout=subprocess.PIPE
        )
        os.set_blocking(viewer.stdout.fileno(), False)
        sent = 0
        while viewer.stdout.read() is None:  # until it looks
            telemetry.put(memoryview(records[0].tobytes()))
            sent += 1
            with contextlib.suppress(subprocess.TimeoutExpired):
                viewer.wait(0.02)
        viewer.send_signal(fate)
        telemetry.drops, sent = 0, sent - telemetry.drops
        put_all(telemetry, records)
        assert telemetry.drops == 0
    viewer.kill()
    viewer.communicate()
    log = read_recording(path)
    assert log.complete
    assert_same({name: column[sent:] for name, column in log.columns.items()}, records)


def recorder_pid():
    """The only child of this process."""
    (children,) = Path(f"/proc/{os.getpid()}/task").glob(f"{os.getpid()}/children")
    return int(children.read_text().split()[-1])


@pytest.mark.parametrize("fate", [signal.SIGKILL, signal.SIGSTOP])
def test_a_recorder_that_dies_or_stands_still_does_not_touch_the_loop(tmp_path, capfd, fate):
    """In simulated time the run is the same to the bit as one that nobody records."""
    alone = make()[0].run()
    with recording(tmp_path / "run.mcap", 1, 0, {}, live=ANYWHERE) as telemetry:
        loop, bus, *_, sent = make()
        pid = recorder_pid()

        class Fatal:
            """Passes ticks on, and after 100 of them the recorder meets its fate."""

            drops = 0

            def put(self, record):
                sent.put(record)
                telemetry.put(record)
                if len(sent.parts) == 100:
                    os.kill(pid, fate)
                    if fate == signal.SIGKILL:
                        os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT)

        loop._log._telemetry = Fatal()
        summary = loop.run()
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)
    assert summary.ended is Ended.FINISHED
    assert summary.records.tobytes() == alone.records.tobytes()
    assert len(sent.parts) == summary.ticks
    if fate == signal.SIGKILL:
        assert telemetry.drops >= summary.ticks - 100
    assert bus.calls[-1] == "torque off"


def test_an_address_that_cannot_be_listened_at_is_refused_before_the_start(capfd):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with (
            pytest.raises(InputError, match=rf"127\.0\.0\.1:{port} cannot be listened at"),
            recording(None, 1, 0, {}, live=LiveConfig(port=port)),
        ):
            pytest.fail("the loop must not start")
    assert capfd.readouterr().err == ""


# --- who is admitted ----------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("origin", ["https://evil.example", "null", "http://127.0.0.1:8000", ""])
def test_a_page_of_another_site_is_refused(capfd, origin):
    with recording(None, 1, 0, {}, live=ANYWHERE):
        with pytest.raises(InvalidStatus) as refused, connect(url_of(capfd), origin=origin):
            pytest.fail("it must not be admitted")
        assert refused.value.response.status_code == 403


@pytest.mark.parametrize("end", ["\r\n", "\n", "\r"])
def test_no_end_of_a_line_hides_an_origin(end):
    gate = LiveGate(("127.0.0.1", 0), ("127.0.0.1", 1), ORIGINS, 8)
    try:
        known, foreign = (
            f"GET / HTTP/1.1\r\nA: b{end}origin : {origin}\r\n\r\n".encode()
            for origin in (ORIGINS[0], "https://evil.example")
        )
        assert gate._is_admitted(known) and not gate._is_admitted(foreign)
    finally:
        gate.close()


@pytest.mark.slow
@pytest.mark.parametrize("origin", [*ORIGINS, None])
def test_foxglove_and_programs_that_are_no_browser_are_admitted(capfd, origin):
    with (
        recording(None, 1, 0, {}, live=ANYWHERE),
        connect(url_of(capfd), subprotocols=["foxglove.sdk.v1"], origin=origin) as viewer,
    ):
        assert json.loads(viewer.recv(PATIENCE_S))["name"] == "dropstitch"


def test_one_viewer_too_many_is_refused_until_another_leaves(capfd):
    with recording(None, 1, 0, {}, live=LiveConfig(port=0, viewers=2)):
        url = url_of(capfd)
        with subscribed(url):
            with subscribed(url):
                with pytest.raises(InvalidStatus) as refused, connect(url):
                    pytest.fail("it must not be admitted")
                assert refused.value.response.status_code == 503
            for _ in range(100):  # the gate learns of it a little later
                with contextlib.suppress(InvalidStatus), subscribed(url):
                    return
            pytest.fail("the place of the one that left stays taken")


@pytest.mark.parametrize(
    "request_", [b"GET / HTTP/1.1\r\n" + b"a: b\r\n" * 5000, b"\xff" * 10_000 + b"\r\n\r\n"]
)
def test_a_request_without_an_end_is_dropped_and_others_are_served(capfd, request_):
    with recording(None, 1, 0, {}, live=ANYWHERE):
        url = url_of(capfd)
        with socket.create_connection(("127.0.0.1", int(url.rpartition(":")[2]))) as hostile:
            hostile.settimeout(PATIENCE_S)
            with contextlib.suppress(OSError):
                hostile.sendall(request_)
                assert hostile.recv(100) == b""
        with subscribed(url):
            pass


def test_connections_that_say_nothing_are_bounded(capfd):
    with (
        recording(None, 1, 0, {}, live=LiveConfig(port=0, viewers=1)),
        contextlib.ExitStack() as stack,
    ):
        port = int(url_of(capfd).rpartition(":")[2])
        ends = [
            stack.enter_context(socket.create_connection(("127.0.0.1", port))) for _ in range(40)
        ]
        ends[-1].settimeout(PATIENCE_S)
        assert ends[-1].recv(100) == b"", "it is closed before it has asked for anything"
