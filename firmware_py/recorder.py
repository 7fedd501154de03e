"""The recorder: a process beside the loop that writes its ticks to an MCAP file.

::

    loop ── SEQPACKET, one packed record a tick ──► receiving thread ── queue ──► writing thread

The kernel queues only a few packets for a socket (`net.unix.max_dgram_qlen`, often 10), so one
thread does nothing but receive, and a slow disk fills memory here instead of dropping ticks there.
The process ends when the loop's end of the socket closes, however the loop died, and leaves a
complete file behind. Run as `python -m firmware_py.recorder`, it reads its task from stdin.
"""

from __future__ import annotations

import contextlib
import os
import queue
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from firmware_py.errors import InputError
from firmware_py.recording import (
    CHUNK_BYTES,
    METADATA,
    SCHEMA_NAME,
    TOPIC,
    require_packages,
    tick_schema,
)
from firmware_py.signals import tick_dtype
from firmware_py.telemetry import SocketTelemetry

_READY: Final = b"ready"
_START_TIMEOUT_S: Final = 20.0
_STOP_TIMEOUT_S: Final = 10.0
_NICENESS: Final = 5


class Task(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What the loop's process asks of the recorder.

    Attributes
    ----------
    fd : int
        Descriptor of the socket, inherited.
    path : str
        File to write.
    dof : int
        Number of joints, which fixes the record.
    start_ns : int
        Wall time of the run's start: `time_s` of a tick is added to it.
    metadata : dict of str to str
        Written into the file as it is.
    """

    fd: int
    path: str
    dof: int
    start_ns: int
    metadata: dict[str, str]


@contextlib.contextmanager
def recording(
    path: Path, dof: int, start_ns: int, metadata: dict[str, str]
) -> Iterator[SocketTelemetry]:
    """Run a recorder for the duration of the context.

    Parameters
    ----------
    path : Path
        File to write; its directory is made.
    dof : int
        Number of joints.
    start_ns : int
        Wall time of the run's start.
    metadata : dict of str to str
        Written into the file, `dof` is added.

    Yields
    ------
    SocketTelemetry
        For the loop.

    Raises
    ------
    InputError
        If the packages are missing or the file cannot be written.
    """
    require_packages()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            path.parent, f"cannot be made ({error.strerror})", "name another directory for logs"
        ) from None
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    task = Task(
        fd=theirs.fileno(), path=str(path), dof=dof, start_ns=start_ns,
        metadata={"dof": str(dof)} | metadata,
    )  # fmt: skip
    process = subprocess.Popen(
        [sys.executable, "-m", "firmware_py.recorder"],
        stdin=subprocess.PIPE,
        pass_fds=(theirs.fileno(),),
        start_new_session=True,  # a Ctrl-C in the terminal is for the loop alone
    )
    theirs.close()
    try:
        assert process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            process.stdin.write(msgspec.json.encode(task))
            process.stdin.close()
        ours.settimeout(_START_TIMEOUT_S)
        if ours.recv(len(_READY)) != _READY:
            raise InputError(path, "cannot be written", "see the recorder's message above")
        yield SocketTelemetry(ours)
    finally:
        ours.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(_STOP_TIMEOUT_S)


def main() -> int:
    """Write one file, until the loop closes its end."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # it outlives the loop by design
    os.nice(_NICENESS)
    task = msgspec.json.decode(sys.stdin.buffer.read(), type=Task)
    end = socket.socket(fileno=task.fd)
    packets: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    try:
        with open(task.path, "wb") as stream:
            writer = _Writer(stream, task)
            end.send(_READY)
            threading.Thread(target=_receive, args=(end, packets), daemon=True).start()
            while record := packets.get():
                writer.write(record)
            writer.finish()
    except OSError as error:
        print(f"recorder: {task.path}: {error.strerror}", file=sys.stderr)
        return 1
    return 0


def _receive(end: socket.socket, packets: queue.SimpleQueue[bytes]) -> None:
    """Pass packets on; an empty one, as the closed socket gives, ends the file."""
    record = b"-"
    while record:
        try:
            record = end.recv(1 << 16)
        except OSError:
            record = b""
        packets.put(record)


class _Writer:
    """The MCAP file; flushed to the disk whenever a chunk is full."""

    def __init__(self, stream: Any, task: Task) -> None:
        from mcap.writer import CompressionType, Writer

        self._dtype = tick_dtype(task.dof)
        self._names = self._dtype.names or ()
        self._time_index = self._names.index("time_s")
        self._start_ns, self._stream = task.start_ns, stream
        self._writer = Writer(stream, chunk_size=CHUNK_BYTES, compression=CompressionType.LZ4)
        self._writer.start(profile="", library="dropstitch")
        self._writer.add_metadata(METADATA, task.metadata)
        schema = self._writer.register_schema(
            SCHEMA_NAME, "jsonschema", msgspec.json.encode(tick_schema(task.dof))
        )
        self._channel = self._writer.register_channel(TOPIC, "json", schema)
        self._encode = msgspec.json.Encoder().encode
        self._sequence, self._flushed = 0, stream.tell()
        self._flush()

    def write(self, record: bytes) -> None:
        """Add one tick; non-finite numbers become null."""
        values = np.frombuffer(record, self._dtype)[0].item()
        time_ns = self._start_ns + round(values[self._time_index] * 1e9)
        data = self._encode(dict(zip(self._names, values, strict=True)))
        self._writer.add_message(self._channel, time_ns, data, time_ns, self._sequence)
        self._sequence += 1
        if self._stream.tell() != self._flushed:  # a chunk was written
            self._flush()

    def _flush(self) -> None:
        self._stream.flush()
        os.fsync(self._stream.fileno())
        self._flushed = self._stream.tell()

    def finish(self) -> None:
        """Write the last chunk and the index."""
        self._writer.finish()
        self._flush()


if __name__ == "__main__":
    sys.exit(main())
