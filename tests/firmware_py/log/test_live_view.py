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

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from firmware_py.core.errors import InputError
from firmware_py.log.live_gate import LiveGate
from firmware_py.log.recorder import recording
from firmware_py.log.recording import SCHEMA_NAME, TOPIC, read_recording, tick_schema
from firmware_py.log.sinks import LiveConfig
from tests.firmware_py.log.test_recorder import ROOT, assert_same, put_all, ticks

ORIGINS = LiveConfig().origins
PATIENCE_S = 30


@pytest.fixture
def serve(capfd):
    """Serve ticks, in a file as well if it has a path; return the telemetry and the address."""
    with contextlib.ExitStack() as stack:

        def serve(path=None, dof=1, **options):
            live = LiveConfig(port=0, **options)
            telemetry = stack.enter_context(recording(path, dof, 10**18, {}, live=live))
            return telemetry, re.search(r"ws://127\.0\.0\.1:\d+", capfd.readouterr().err).group()

        yield serve


@contextlib.contextmanager
def subscribed(url):
    """A connection that subscribed to the ticks, and the channel that the server offers."""
    with connect(url, subprotocols=["foxglove.sdk.v1"]) as viewer:
        assert json.loads(viewer.recv(PATIENCE_S))["name"] == "dropstitch"
        (channel,) = json.loads(viewer.recv(PATIENCE_S))["channels"]
        wish = {"op": "subscribe", "subscriptions": [{"id": 1, "channelId": channel["id"]}]}
        viewer.send(json.dumps(wish))
        yield viewer, channel


def tick_of(packet):
    """Wall time and content of a message, without Foxglove's binary frame."""
    assert packet[0] == 1
    return int.from_bytes(packet[5:13], "little"), json.loads(packet[13:])


def first_message(viewer, telemetry, record):
    """Send a record again and again: the server begins some time after the subscription."""
    while True:
        telemetry.put(memoryview(record.tobytes()))
        with contextlib.suppress(TimeoutError):
            return viewer.recv(0.05)


def test_a_viewer_gets_every_tick_with_its_schema(serve):
    records = ticks(200)
    telemetry, url = serve(dof=2)
    with subscribed(url) as (viewer, channel):
        assert (channel["topic"], channel["schemaName"]) == (TOPIC, SCHEMA_NAME)
        assert (channel["encoding"], channel["schemaEncoding"]) == ("json", "jsonschema")
        assert json.loads(channel["schema"]) == tick_schema(2)
        first = records[0].copy()
        first["tick"] = -1
        assert tick_of(first_message(viewer, telemetry, first))[1]["tick"] == -1
        put_all(telemetry, records)
        arrived = []
        while len(arrived) < len(records):
            arrived.append(tick_of(viewer.recv(PATIENCE_S)))
            if arrived[-1][1]["tick"] == -1:
                arrived.pop()  # a repetition of the first
    times_ns = [10**18 + round(time_s * 1e9) for time_s in records["time_s"]]
    assert [time_ns for time_ns, _ in arrived] == times_ns
    for name in ("tick", "angle_1_rad", "current_2_a", "busy_ns"):
        assert [tick[name] for _, tick in arrived] == records[name].tolist()


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
    with recording(path, 2, 10**18, {}, live=LiveConfig(port=0)) as telemetry:
        url = re.search(r"ws://127\.0\.0\.1:\d+", capfd.readouterr().err).group()
        viewer = subprocess.Popen(
            [sys.executable, "-c", VIEWER, url], cwd=ROOT, stdout=subprocess.PIPE
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


def test_an_address_in_use_is_refused_before_the_start(capfd):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with (
            pytest.raises(InputError, match=rf"127\.0\.0\.1:{port} cannot be listened at"),
            recording(None, 1, 0, {}, live=LiveConfig(port=port)),
        ):
            pytest.fail("the loop must not start")
    assert capfd.readouterr().err == ""


# --- who is admitted ----------------------------------------------------------------------------


def status_of(url, **options):
    """HTTP status of a refusal; None where the viewer is admitted."""
    try:
        with connect(url, subprotocols=["foxglove.sdk.v1"], **options) as viewer:
            assert json.loads(viewer.recv(PATIENCE_S))["name"] == "dropstitch"
    except InvalidStatus as refused:
        return refused.response.status_code
    return None


def test_foxglove_and_programs_are_admitted_and_pages_of_other_sites_are_not(serve):
    _, url = serve()
    for origin in (*ORIGINS, None):
        assert status_of(url, origin=origin) is None
    for origin in ("https://evil.example", "null", "http://127.0.0.1:8000", ""):
        assert status_of(url, origin=origin) == 403


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


def test_one_viewer_too_many_is_refused_until_another_leaves(serve):
    _, url = serve(viewers=2)
    with subscribed(url), subscribed(url):
        assert status_of(url) == 503
    for _ in range(100):  # the gate notices it a little later
        if status_of(url) is None:
            return
    pytest.fail("a viewer that left still counts")


def test_silent_connections_and_requests_without_an_end_are_dropped(serve):
    _, url = serve(viewers=1)
    address = ("127.0.0.1", int(url.rpartition(":")[2]))
    with contextlib.ExitStack() as stack:
        ends = [stack.enter_context(socket.create_connection(address)) for _ in range(40)]
        ends[-1].settimeout(PATIENCE_S)
        assert ends[-1].recv(100) == b"", "it is closed before it has asked for anything"
    for request in (b"GET / HTTP/1.1\r\n" + b"a: b\r\n" * 5000, b"\xff" * 10_000 + b"\r\n\r\n"):
        with socket.create_connection(address) as hostile:
            hostile.settimeout(PATIENCE_S)
            with contextlib.suppress(OSError):
                hostile.sendall(request)
                assert hostile.recv(100) == b""
    for _ in range(100):  # others are served as soon as the gate has noticed
        if status_of(url) is None:
            return
    pytest.fail("nobody is served any more")
