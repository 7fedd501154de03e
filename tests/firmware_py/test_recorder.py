"""From the loop's socket to a file and back, with the recorder slow, dead or cut off."""

import ctypes
import json
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from firmware_py.errors import InputError
from firmware_py.recorder import Task, _Writer, recording
from firmware_py.recording import read_recording, tick_schema
from firmware_py.signals import tick_dtype, tick_signals
from firmware_py.telemetry import SocketTelemetry

ROOT = Path(__file__).parents[2]
PR_SET_CHILD_SUBREAPER = 36


def ticks(count, dof=2):
    """Records with every bit pattern that a log must keep, from a fixed seed."""
    rng = np.random.default_rng(7)
    records = np.zeros(count, tick_dtype(dof))
    for name in records.dtype.names:
        if records.dtype[name].kind == "i":
            records[name] = rng.integers(-(2**52), 2**52, count)
        else:
            records[name] = rng.standard_normal(count) * 10.0 ** rng.integers(-12, 6, count)
    records["time_s"] = 0.017 * np.arange(count)
    records["payload_kg"][::3] = np.nan
    return records


def put_all(telemetry, records):
    """Hand over every record, waiting where the recorder is behind."""
    os.set_blocking(telemetry._send.__self__.fileno(), True)
    for record in records:
        telemetry.put(memoryview(record.tobytes()))


def write(path, records, dof=2, metadata=None):
    with open(path, "wb") as stream:
        task = Task(fd=0, path=str(path), dof=dof, start_ns=10**18,
                    metadata={"dof": str(dof)} | (metadata or {}))  # fmt: skip
        writer = _Writer(stream, task)
        for record in records:
            writer.write(record.tobytes())
        writer.finish()


def assert_same(columns, records):
    for name in records.dtype.names:
        assert np.array_equal(columns[name], records[name].astype(float), equal_nan=True), name


@pytest.mark.parametrize("dof", [1, 2])
def test_what_the_loop_sends_is_read_back_to_the_bit(tmp_path, dof):
    records, path = ticks(300, dof), tmp_path / "new" / "run.mcap"
    with recording(path, dof, 10**18, {"config": "{}"}) as telemetry:
        put_all(telemetry, records)
    log = read_recording(path)
    assert log.complete
    assert log.metadata == {"dof": str(dof), "config": "{}"}
    assert_same(log.columns, records)
    assert telemetry.drops == 0


def test_the_file_declares_every_column_with_its_unit(tmp_path):
    from mcap.reader import make_reader

    write(tmp_path / "run.mcap", ticks(3))
    with open(tmp_path / "run.mcap", "rb") as stream:
        (schema, channel, message), *_ = make_reader(stream).iter_messages()
    assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
    properties = json.loads(schema.data)["properties"]
    assert list(properties) == [s.name for s in tick_signals(2)] == list(json.loads(message.data))
    assert properties["angle_1_rad"]["unit"] == "rad"
    assert json.loads(schema.data) == tick_schema(2)


def test_a_log_cut_off_anywhere_is_read_up_to_its_last_whole_chunk(tmp_path):
    records, whole = ticks(400), tmp_path / "whole.mcap"
    write(whole, records)
    data = whole.read_bytes()
    seen = []
    for cut in np.linspace(len(data) * 0.4, len(data) - 1, 25).astype(int):
        path = tmp_path / "cut.mcap"
        path.write_bytes(data[:cut])
        log = read_recording(path)
        count = len(log.columns["tick"])
        assert not log.complete
        assert_same(log.columns, records[:count])
        seen.append(count)
    assert seen == sorted(seen)
    assert 0 < seen[0] < seen[-1] == 400


def test_the_file_is_complete_though_the_loop_was_killed(tmp_path):
    path = tmp_path / "run.mcap"
    code = f"""
import os, signal
from pathlib import Path
from firmware_py.recorder import recording
from tests.firmware_py.test_recorder import put_all, ticks
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


def test_a_log_that_cannot_be_written_is_refused_before_the_start(tmp_path, capfd):
    (tmp_path / "run.mcap").mkdir()
    with (
        pytest.raises(InputError, match=r"run\.mcap"),
        recording(tmp_path / "run.mcap", 1, 0, {}),
    ):
        pytest.fail("the loop must not start")
    assert "recorder:" in capfd.readouterr().err


@pytest.mark.parametrize("package", ["mcap", "lz4"])
def test_without_the_extra_one_sentence_says_what_to_do(tmp_path, monkeypatch, package):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name == package else name)
    with (
        pytest.raises(
            InputError, match=r"pip install 'dropstitch\[record\]', or set record = false"
        ),
        recording(tmp_path / "run.mcap", 1, 0, {}),
    ):
        pytest.fail("the loop must not start")


@pytest.mark.parametrize("content", [b"", b"time_s,angle\n", bytes(1000)])
def test_a_file_that_is_no_log_is_refused(tmp_path, content):
    path = tmp_path / "other.mcap"
    path.write_bytes(content)
    with pytest.raises(InputError, match="log"):
        read_recording(path)


def test_a_missing_log_is_refused(tmp_path):
    with pytest.raises(InputError, match="missing"):
        read_recording(tmp_path / "none.mcap")


def test_the_loops_process_never_imports_the_writer():
    code = (
        "import sys, firmware_py.commands.run, firmware_py.loop\n"
        "sys.exit(any(name.split('.')[0] in ('mcap', 'lz4') for name in sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT).returncode == 0
