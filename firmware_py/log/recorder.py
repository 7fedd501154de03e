"""Recorder: a process beside the loop that writes its ticks to a file and serves them live.

::

    loop ── SEQPACKET, one packed record per tick ► receiving thread ── queue ──► writing thread
                                                                    viewers ◄──┘ └──► MCAP file

The kernel queues only a few packets for a socket (`net.unix.max_dgram_qlen`, often 10), so one
thread only receives. A slow disk then fills the memory of this process, and no ticks are dropped.
The process ends when the loop's end of the socket closes, for any reason, with a complete file.
Finally it reports the number of ticks in the file through the socket.
Started as `python -m firmware_py.log.recorder`, it reads its task from stdin.
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
from typing import Final

import msgspec

from firmware_py.core.errors import InputError
from firmware_py.core.output_files import make_directory
from firmware_py.core.standard_streams import lasting_streams
from firmware_py.log.recording import require_packages
from firmware_py.log.scene import SCENE_TOPIC, SceneEncoder, shape_in
from firmware_py.log.sinks import (
    LiveConfig,
    LiveSink,
    McapSink,
    Sink,
    TickEncoder,
    require_live_package,
)
from firmware_py.log.telemetry import SocketTelemetry

_READY: Final = b"ready"
_ANSWER_BYTES: Final = 4096
_START_TIMEOUT_S: Final = 20.0
_STOP_TIMEOUT_S: Final = 10.0
_EXIT_TIMEOUT_S: Final = 2.0
_NICENESS: Final = 5


class RecorderTask(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    fd: int  # Descriptor of the socket, inherited
    path: str | None
    live: LiveConfig | None = None  # None serves no live view
    dof: int  # Number of joints, which determines the layout of a record
    start_ns: int  # Wall time of the start of the run, to which `time_s` of a tick is added
    metadata: dict[str, str]


@contextlib.contextmanager
def recording(
    path: Path | None,
    dof: int,
    start_ns: int,
    metadata: dict[str, str],
    live: LiveConfig | None = None,
) -> Iterator[SocketTelemetry]:
    """Run a recorder during the context, and yield the telemetry for the loop.

    `path`: file to write, whose directory is made; None writes no file. After the block, `logged`
    of the telemetry is the number of ticks in the file.
    """
    if path is not None:
        require_packages()
        make_directory(path.parent, "name another directory for logs")
    if live is not None:
        require_live_package()
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    task = RecorderTask(
        fd=theirs.fileno(), path=None if path is None else str(path), live=live, dof=dof,
        start_ns=start_ns, metadata={"dof": str(dof)} | metadata,
    )  # fmt: skip
    process = _spawned(theirs)
    theirs.close()
    telemetry = None
    try:
        _hand_over(task, process)
        _await_start(ours)
        telemetry = SocketTelemetry(ours)
        yield telemetry
    finally:
        process.send_signal(signal.SIGCONT)  # a recorder that somebody stopped ends its file, too
        if telemetry is not None:
            telemetry.logged = _await_end(ours)
        ours.close()
        _end(process)


def _spawned(end: socket.socket) -> subprocess.Popen[bytes]:
    """Start a recorder process that inherits its end of the socket."""
    return subprocess.Popen(
        [sys.executable, "-m", "firmware_py.log.recorder"],
        stdin=subprocess.PIPE,
        pass_fds=(end.fileno(),),
        start_new_session=True,  # a Ctrl-C in the terminal must reach the loop only
    )


def _end(process: subprocess.Popen[bytes]) -> None:
    """Wait for the end of a recorder; kill one that hangs, so that none stays behind."""
    try:
        process.wait(_EXIT_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        with contextlib.suppress(subprocess.TimeoutExpired):  # it waits for a dead disk
            process.wait(_EXIT_TIMEOUT_S)


def _hand_over(task: RecorderTask, process: subprocess.Popen[bytes]) -> None:
    if process.stdin is not None:
        with contextlib.suppress(BrokenPipeError):
            process.stdin.write(msgspec.json.encode(task))
            process.stdin.close()


def _await_start(ours: socket.socket) -> None:
    """Wait until the recorder is ready, or raise its error."""
    ours.settimeout(_START_TIMEOUT_S)
    try:
        answer = ours.recv(_ANSWER_BYTES)
    except TimeoutError:
        answer = b""
    if not answer:
        raise InputError("recorder", "does not start", "see its message above")
    if answer != _READY:
        raise InputError(*msgspec.json.decode(answer, type=tuple[str, str, str]))


def _await_end(ours: socket.socket) -> int | None:
    """End the log; return its number of ticks, or None if the recorder does not report it."""
    with contextlib.suppress(OSError):  # the recorder may have ended already
        ours.shutdown(socket.SHUT_WR)
    try:
        ours.settimeout(_STOP_TIMEOUT_S)
        return msgspec.json.decode(ours.recv(_ANSWER_BYTES) or b"null", type=int | None)
    except (OSError, msgspec.MsgspecError):
        return None


def main() -> int:
    """Record one run until the loop closes its end; return 1 if the file was not completed."""
    for number in (signal.SIGHUP, signal.SIGINT, signal.SIGQUIT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # the recorder ends after the loop
    os.nice(_NICENESS)
    with lasting_streams():  # a closed terminal must not end the log
        return _record()


def _record() -> int:
    handed = sys.stdin.buffer.read()
    if not handed:  # a signal ended the loop first
        return 1
    task = msgspec.json.decode(handed, type=RecorderTask)
    end = socket.socket(fileno=task.fd)
    try:
        sinks = list(_sinks(task))
    except InputError as error:
        with contextlib.suppress(OSError):  # a signal ended the loop meanwhile
            end.send(msgspec.json.encode((error.where, error.what, error.remedy)))
        return 1
    shape = shape_in(task.metadata)
    scene = SceneEncoder(task.dof, shape) if shape else None
    packets: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    with contextlib.suppress(OSError):  # likewise; the log then is complete without a tick
        end.send(_READY)
    threading.Thread(target=_receive, args=(end, packets), daemon=True).start()
    code = _pass_on(packets, list(sinks), TickEncoder(task.dof, task.start_ns), scene)
    ticks = next((sink.ticks for sink in sinks if sink.ticks is not None), None)
    with contextlib.suppress(OSError):  # the loop was killed
        end.send(msgspec.json.encode(ticks))
    return code


def _sinks(task: RecorderTask) -> Iterator[Sink]:
    """Open the sinks of a task; the live view first, because it never waits."""
    if task.live is not None:
        shown = shape_in(task.metadata) is not None
        live = LiveSink(task.live, task.dof, shown)
        print(f"live view at {live.url}: 'Open connection' in Foxglove", file=sys.stderr)
        yield live
    if task.path is not None:
        yield McapSink(task.path, task.dof, task.metadata)


def _receive(end: socket.socket, packets: queue.SimpleQueue[bytes]) -> None:
    """Put packets into the queue; an empty packet, from a closed socket, ends the run."""
    record = b"-"
    while record:
        try:
            record = end.recv(1 << 16)
        except OSError:
            record = b""
        packets.put(record)


def _pass_on(
    packets: queue.SimpleQueue[bytes],
    sinks: list[Sink],
    encode: TickEncoder,
    scene: SceneEncoder | None,
) -> int:
    """Write every tick and its scene to every sink; drop a sink that fails (a full disk)."""
    code = 0
    while (record := packets.get()) and sinks:
        time_ns, data = encode(record)
        drawn = scene(record, time_ns) if scene else None
        for sink in tuple(sinks):
            try:
                sink.write(time_ns, data)
                if drawn is not None:
                    sink.write(time_ns, drawn, SCENE_TOPIC)
            except OSError as error:
                code = _give_up(sinks, sink, error)
    for sink in tuple(sinks):
        try:
            sink.finish()
        except OSError as error:
            code = _give_up(sinks, sink, error)
    return code


def _give_up(sinks: list[Sink], sink: Sink, error: OSError) -> int:
    sinks.remove(sink)
    print(f"recorder: the log ends here ({error.strerror})", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
