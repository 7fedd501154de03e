"""Path of a tick from the loop's socket to a file and back, also with a slow or dead recorder."""

import contextlib
import ctypes
import json
import os
import signal
import socket
import struct
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk

from firmware_py.commands.run import _free_log
from firmware_py.core.errors import InputError
from firmware_py.core.signals import PERIOD_S, tick_dtype, tick_signals
from firmware_py.log.recorder import recording
from firmware_py.log.recording import read_recording, tick_schema
from firmware_py.log.sinks import McapSink, TickEncoder
from firmware_py.log.telemetry import SocketTelemetry

ROOT = Path(__file__).parents[3]
PR_SET_CHILD_SUBREAPER = 36
MAGIC, CHUNK = b"\x89MCAP0\r\n", 6


def ticks(count, dof=2):
    """Records with every bit pattern that a log must preserve, from a fixed seed."""
    rng = np.random.default_rng(7)
    records = np.zeros(count, tick_dtype(dof))
    for name in records.dtype.names:
        if records.dtype[name].kind == "i":
            records[name] = rng.integers(-(2**62), 2**62, count)
        else:
            records[name] = rng.standard_normal(count) * 10.0 ** rng.integers(-12, 6, count)
    records["time_s"] = 0.017 * np.arange(count)
    records["payload_kg"][::3] = np.nan
    records["di"][1::3], records["di"][2::3] = np.inf, -np.inf
    records["current_1_a"][::2] = -0.0
    return records


def put_all(telemetry, records):
    """Hand over every record, waiting where the recorder is behind."""
    telemetry._send.__self__.settimeout(60)
    for record in records:
        telemetry.put(memoryview(record.tobytes()))


def write(path, records, dof=2, metadata=None):
    encode = TickEncoder(dof, 10**18)
    sink = McapSink(str(path), dof, {"dof": str(dof)} | (metadata or {}))
    for record in records:
        sink.write(*encode(record.tobytes()))
    sink.finish()


def assert_same(columns, records):
    for name in records.dtype.names:
        assert columns[name].dtype == records[name].dtype, name
        assert np.array_equal(columns[name], records[name], equal_nan=True), name
        assert np.array_equal(np.signbit(columns[name]), np.signbit(records[name])), name


@pytest.mark.parametrize("dof", [1, 2])
def test_the_ticks_of_the_loop_are_read_back_to_the_bit(tmp_path, dof):
    records, path = ticks(300, dof), tmp_path / "new" / "run.mcap"
    with recording(path, dof, 10**18, {"config": "{}"}) as telemetry:
        put_all(telemetry, records)
    log = read_recording(path)
    assert log.complete
    assert log.metadata == {"dof": str(dof), "config": "{}"}
    assert_same(log.columns, records)
    assert (telemetry.drops, telemetry.logged) == (0, len(records))


def test_the_file_declares_every_column_with_its_unit(tmp_path):
    records = ticks(3)
    write(tmp_path / "run.mcap", records)
    assert_same(read_recording(tmp_path / "run.mcap", 2).columns, records[:2])
    with open(tmp_path / "run.mcap", "rb") as stream:
        (schema, channel, message), *_ = make_reader(stream).iter_messages()
    assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
    properties = json.loads(schema.data)["properties"]
    assert list(properties) == [s.name for s in tick_signals(2)] == list(json.loads(message.data))
    assert properties["angle_1_rad"]["unit"] == "rad"
    assert json.loads(schema.data) == tick_schema(2)


class Whole(NamedTuple):
    """A log of several chunks."""

    records: np.ndarray
    data: bytes
    ends: list  # where each chunk ends, and the ticks up to there


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("whole") / "run.mcap"
    records = ticks(200)
    write(path, records)
    data, ends, position = path.read_bytes(), [], len(MAGIC)
    while position < len(data) - len(MAGIC):  # by the MCAP specification: opcode, length, content
        opcode, length = struct.unpack_from("<BQ", data, position)
        position += 9 + length
        if opcode == CHUNK:
            ends.append(position)
    with path.open("rb") as stream:
        chunks = [c for c in StreamReader(stream, emit_chunks=True).records if isinstance(c, Chunk)]
    counts = [sum(isinstance(r, Message) for r in breakup_chunk(chunk)) for chunk in chunks]
    assert len(ends) == len(counts) > 3
    assert sum(counts) == len(records)
    return Whole(records, data, [*zip(ends, np.cumsum(counts).tolist(), strict=True)])


def assert_cut_is_read(directory, whole, cut, tail):
    """A file cut at `cut` and followed by `tail` gives every whole chunk, and says it was cut."""
    path, content = directory / "cut.mcap", whole.data[:cut] + tail
    path.write_bytes(content)
    # The tail may begin with what was there: an LZ4 frame ends in zeros.
    pairs = enumerate(zip(content, whole.data, strict=False))
    intact = next((k for k, (now, was) in pairs if now != was), min(len(content), len(whole.data)))
    expected = max((count for end, count in whole.ends if end <= intact), default=0)
    if not expected:
        with pytest.raises(InputError, match=r"cut\.mcap"):
            read_recording(path)
        return
    log = read_recording(path)
    # The tail may be what was cut off: then the log is whole.
    assert log.complete == content.startswith(whole.data)
    assert len(log.columns["tick"]) == expected
    assert_same(log.columns, whole.records[:expected])


TAILS = {"nothing": b"", "zeros": bytes(4096), "litter": bytes(range(256)) * 4}
"""What a file system may leave behind the cut."""


@given(data=st.data())
@settings(
    max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_a_log_cut_off_at_any_byte_is_read_up_to_its_last_whole_chunk(tmp_path, whole, data):
    size = len(whole.data)
    seams = [0, len(MAGIC), *(end for end, _ in whole.ends), size - len(MAGIC)]
    near_seam = st.tuples(st.sampled_from(seams), st.sampled_from([-1, 0, 1, 8, 9, 10])).map(sum)
    cut = data.draw(st.integers(0, size - 1) | near_seam.filter(lambda at: 0 <= at < size))
    tail = data.draw(st.one_of(st.sampled_from(list(TAILS.values())), st.binary(max_size=64)))
    assert_cut_is_read(tmp_path, whole, cut, tail)


def test_a_log_writes_neither_over_a_file_nor_through_a_link(tmp_path):
    (tmp_path / "file").write_text("precious")
    (tmp_path / "link").symlink_to(tmp_path / "file")
    for name in ("file", "link"):
        with pytest.raises(InputError, match="cannot be written"):
            McapSink(str(tmp_path / name), 1, {"dof": "1"})
    assert (tmp_path / "file").read_text() == "precious"


def test_two_robots_that_share_a_directory_overwrite_no_log(tmp_path):
    names = []
    for _ in range(3):
        names.append(_free_log(tmp_path, "20261122T090000Z_sinusoid").name)
        (tmp_path / names[-1]).symlink_to(tmp_path / "elsewhere")
    (tmp_path / "20261122T090000Z_sinusoid_4.timing.json").write_text("")
    names.append(_free_log(tmp_path, "20261122T090000Z_sinusoid").name)
    assert [name.partition("_sinusoid")[2] for name in names] == [
        ".mcap", "_2.mcap", "_3.mcap", "_5.mcap",
    ]  # fmt: skip


def test_a_recorder_that_dies_takes_half_a_second_with_it_at_most(tmp_path):
    path, encode = tmp_path / "run.mcap", TickEncoder(2, 10**18)
    sink = McapSink(str(path), 2, {"dof": "2"})
    on_disk = [0]
    for record in np.zeros(100, tick_dtype(2)):  # no record is shorter than zeros
        sink.write(*encode(record.tobytes()))
        with contextlib.suppress(InputError):  # as long as no chunk is full
            on_disk.append(len(read_recording(path).columns["tick"]))
    assert max(np.diff(on_disk)) * PERIOD_S <= 0.5
    assert on_disk[-1] > 70


@pytest.mark.slow
def test_the_file_is_complete_after_the_loop_was_killed(tmp_path):
    path = tmp_path / "run.mcap"
    code = f"""
import os, signal
from pathlib import Path
from firmware_py.log.recorder import recording
from tests.firmware_py.log.test_recorder import put_all, ticks
with recording(Path({str(path)!r}), 2, 10**18, {{}}) as telemetry:
    put_all(telemetry, ticks(50))
    os.kill(os.getpid(), signal.SIGKILL)
"""
    libc = ctypes.CDLL(None)
    libc.prctl(PR_SET_CHILD_SUBREAPER, 1)  # the orphaned recorder becomes ours to wait for
    try:
        killed = subprocess.run([sys.executable, "-c", code], cwd=ROOT)
        assert killed.returncode == -signal.SIGKILL
        _, status = os.waitpid(-1, 0)
    finally:
        libc.prctl(PR_SET_CHILD_SUBREAPER, 0)
    assert status == 0
    log = read_recording(path)
    assert log.complete
    assert_same(log.columns, ticks(50))


def test_a_recorder_that_stands_still_or_dies_costs_drops_and_nothing_else():
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    telemetry = SocketTelemetry(ours)
    record = memoryview(bytes(tick_dtype(2).itemsize))
    for _ in range(10_000):  # far beyond what any socket queues; it must not block
        telemetry.put(record)
    queued = 10_000 - telemetry.drops
    assert 0 < queued < 10_000
    theirs.recv(4096)
    telemetry.put(record)
    assert telemetry.drops == 10_000 - queued, "there was room again"
    theirs.close()
    telemetry.put(record)
    assert telemetry.drops == 10_000 - queued + 1
    ours.close()


LIMITED = """
import resource
from pathlib import Path
from firmware_py.core.errors import InputError
from firmware_py.log.recorder import recording
from firmware_py.log.recording import read_recording
from tests.firmware_py.log.test_recorder import put_all, ticks
resource.setrlimit(resource.RLIMIT_FSIZE, ({most}, {most}))
path = Path({path!r})
try:
    with recording(path, 2, 10**18, {{}}) as telemetry:
        put_all(telemetry, ticks(200))
    print(telemetry.logged, len(read_recording(path).columns["tick"]))
except InputError as error:
    print(error, path.exists())
"""


@pytest.mark.slow
def test_a_full_disk_is_reported_with_the_number_of_ticks_that_the_log_holds(tmp_path):
    """No file may be larger than a limit: as on a full disk, a write fails."""

    def limited(path, most):
        code = LIMITED.format(path=str(path), most=most)
        return subprocess.run(
            [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
        )

    ended = limited(tmp_path / "a.mcap", 0)
    assert str(tmp_path / "a.mcap") in ended.stdout and "File too large" in ended.stdout
    assert ended.stdout.endswith("False\n"), "no empty file stays"
    assert ended.stderr == "", "no traceback of the recorder"
    ended = limited(tmp_path / "b.mcap", 60_000)
    logged, readable = map(int, ended.stdout.split())
    assert 0 < logged == readable < 200
    assert "File too large" in ended.stderr and ended.stderr.count("\n") == 1


@pytest.fixture
def spawned(monkeypatch):
    """Recorder processes that the test starts."""
    processes, start = [], subprocess.Popen

    def spawn(*arguments, **options):
        processes.append(start(*arguments, **options))
        return processes[-1]

    monkeypatch.setattr(subprocess, "Popen", spawn)
    return processes


def test_a_stopped_recorder_is_resumed_and_one_that_hangs_is_killed(tmp_path, spawned, monkeypatch):
    path = tmp_path / "stopped.mcap"
    with recording(path, 2, 10**18, {}) as telemetry:
        put_all(telemetry, ticks(5))
        spawned[0].send_signal(signal.SIGSTOP)
    assert spawned[0].returncode == 0
    assert telemetry.logged == len(read_recording(path).columns["tick"]) == 5
    monkeypatch.setattr("firmware_py.log.recorder._STOP_TIMEOUT_S", 0.1)
    monkeypatch.setattr("firmware_py.log.recorder._EXIT_TIMEOUT_S", 0.1)
    monkeypatch.setattr(signal, "SIGCONT", signal.SIGSTOP)  # nothing resumes it
    with recording(tmp_path / "run.mcap", 2, 10**18, {}) as telemetry:
        pass
    spawned[1].wait()
    assert (spawned[1].returncode, telemetry.logged) == (-signal.SIGKILL, None)


@pytest.mark.parametrize("package", ["mcap", "lz4"])
def test_without_the_extra_one_sentence_names_the_remedy(tmp_path, monkeypatch, package):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name == package else name)
    with (
        pytest.raises(
            InputError, match=r"pip install 'dropstitch\[record\]', or set record = false"
        ),
        recording(tmp_path / "run.mcap", 1, 0, {}),
    ):
        pytest.fail("the loop must not start")


def test_the_loops_process_never_imports_the_writer():
    code = (
        "import sys, firmware_py.commands.run, firmware_py.loop\n"
        "ours = {name.split('.')[0] for name in sys.modules}\n"
        "sys.exit(bool(ours & {'mcap', 'lz4', 'foxglove'}))"
    )
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT).returncode == 0


@pytest.mark.parametrize("place", ["run.mcap", "no_directory/run.mcap", None])
def test_a_loop_that_ends_while_its_recorder_starts_gets_no_traceback(tmp_path, place):
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours.close()
    task = {
        "fd": theirs.fileno(), "path": str(tmp_path / (place or "")), "dof": 1, "start_ns": 0,
        "metadata": {"dof": "1"},
    }  # fmt: skip
    recorder = subprocess.run(
        [sys.executable, "-m", "firmware_py.log.recorder"],
        input=json.dumps(task).encode() if place else b"", pass_fds=(theirs.fileno(),),
        capture_output=True, timeout=120,
    )  # fmt: skip
    theirs.close()
    assert recorder.stderr == b""
    if place == "run.mcap":
        assert (tmp_path / place).read_bytes().endswith(MAGIC), "complete, without a tick"
