"""Sinks of the recorder process: an MCAP file and a live view, with the same messages.

A sink imports its packages when it is created, in the recorder process only.
"""

from __future__ import annotations

import contextlib
import importlib.util
import math
import os
import secrets
from typing import Any, Final, Protocol

import msgspec
import numpy as np

from firmware_py.core.errors import InputError
from firmware_py.core.signals import tick_dtype
from firmware_py.log.recording import CHUNK_BYTES, METADATA, SCHEMA_NAME, TOPIC, tick_schema
from firmware_py.log.scene import SCENE_SCHEMA, SCENE_TOPIC, SHAPE_KEY, scene_schema


class LiveConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Table `[live]`: address at which `dropstitch run --live` serves the ticks to Foxglove."""

    # Address to listen on. Whoever can reach it sees the ticks, but cannot command the robot.
    host: str = "127.0.0.1"
    port: int = 8765  # TCP port; 0 chooses a free one
    # Web sites whose pages may connect: Foxglove's page and desktop program. A program that is no
    # browser sends no origin and is admitted.
    origins: tuple[str, ...] = ("https://app.foxglove.dev", "file://")
    viewers: int = 8  # Largest number of viewers


_INFINITIES: Final = {math.inf: "Infinity", -math.inf: "-Infinity"}
_VIEWER_BACKLOG: Final = 256
"""Backlog of a slow viewer in messages; beyond it, the oldest are dropped."""


class Sink(Protocol):
    def write(self, time_ns: int, data: bytes, topic: str = TOPIC) -> None:
        """Write one message."""

    def finish(self) -> None:
        """Complete the output after the last tick."""

    @property
    def ticks(self) -> int | None:
        """Number of ticks in the output; None if it stores none."""


class TickEncoder:
    """Exact encoder of packed records as JSON; NaN becomes null, an infinity a string.

    `start_ns`: wall time of the start of the run, to which `time_s` of a tick is added.
    """

    def __init__(self, dof: int, start_ns: int) -> None:
        self._dtype = tick_dtype(dof)
        self._names = self._dtype.names or ()
        self._time_index = self._names.index("time_s")
        self._start_ns = start_ns
        self._encode = msgspec.json.Encoder().encode

    def __call__(self, record: bytes) -> tuple[int, bytes]:
        """Return the wall time of the tick in ns and its message."""
        values = np.frombuffer(record, self._dtype)[0].item()
        time_ns = self._start_ns + round(values[self._time_index] * 1e9)
        if not _INFINITIES.keys().isdisjoint(values):  # JSON has no number for them
            values = [_INFINITIES.get(value, value) for value in values]
        return time_ns, self._encode(dict(zip(self._names, values, strict=True)))


class McapSink:
    """MCAP file of small LZ4 chunks, each written to disk as soon as it is full.

    `path`: new file; an existing file or link is never overwritten.
    """

    def __init__(self, path: str, dof: int, metadata: dict[str, str]) -> None:
        try:
            self._stream = open(path, "xb")  # noqa: SIM115 (open until finish)
        except OSError as error:
            raise InputError(
                path, f"cannot be written ({error.strerror})", "name another file for the log"
            ) from None
        try:
            self._begin(dof, metadata)
        except OSError as error:  # a full disk
            self._remove(path)
            raise InputError(
                path, f"cannot be written ({error.strerror})",
                "make room on its disk, or name another file for the log",
            ) from None  # fmt: skip

    def _begin(self, dof: int, metadata: dict[str, str]) -> None:
        """Write schemas, channels and metadata, before the first tick."""
        from mcap.writer import CompressionType, Writer

        self.ticks = self._taken = 0
        self._writer = Writer(self._stream, chunk_size=CHUNK_BYTES, compression=CompressionType.LZ4)
        self._writer.start(profile="", library="dropstitch")
        self._writer.add_metadata(METADATA, metadata)
        schema = self._writer.register_schema(SCHEMA_NAME, "jsonschema", _schema_json(dof))
        self._channels = {TOPIC: self._writer.register_channel(TOPIC, "json", schema)}
        if SHAPE_KEY in metadata:
            shown = self._writer.register_schema(SCENE_SCHEMA, "protobuf", scene_schema())
            channel = self._writer.register_channel(SCENE_TOPIC, "protobuf", shown)
            self._channels[SCENE_TOPIC] = channel
        self._sequence = 0
        self._flush()

    def _remove(self, path: str) -> None:
        """Remove the empty file, which would block the next log of this name."""
        with contextlib.suppress(OSError):
            self._stream.close()  # closing tries to write once more
        with contextlib.suppress(OSError):
            os.remove(path)

    def write(self, time_ns: int, data: bytes, topic: str = TOPIC) -> None:
        self._writer.add_message(self._channels[topic], time_ns, data, time_ns, self._sequence)
        self._sequence += 1
        self._taken += topic == TOPIC
        if self._stream.tell() != self._flushed:  # a chunk was written
            self._flush()

    def finish(self) -> None:
        self._writer.finish()
        self._flush()
        self._stream.close()

    def _flush(self) -> None:
        self._stream.flush()
        os.fsync(self._stream.fileno())
        self._flushed = self._stream.tell()
        self.ticks = self._taken


class LiveSink:
    """WebSocket server for Foxglove, in its own threads; a slow viewer loses old ticks."""

    ticks = None

    def __init__(self, live: LiveConfig, dof: int, scene: bool) -> None:
        import foxglove

        from firmware_py.log.live_gate import LiveGate

        ticks = foxglove.Schema(name=SCHEMA_NAME, encoding="jsonschema", data=_schema_json(dof))
        self._channels = {
            TOPIC: foxglove.Channel(TOPIC, message_encoding="json", schema=ticks),
        }
        if scene:
            shown = foxglove.Schema(name=SCENE_SCHEMA, encoding="protobuf", data=scene_schema())
            self._channels[SCENE_TOPIC] = foxglove.Channel(
                SCENE_TOPIC, message_encoding="protobuf", schema=shown
            )
        # The server is unprotected, so it hides at one of 16 million addresses, on any port.
        hidden = ".".join(["127", *(str(1 + secrets.randbelow(254)) for _ in range(3))])
        try:
            self._server: Any = foxglove.start_server(
                name="dropstitch", host=hidden, port=0, message_backlog_size=_VIEWER_BACKLOG
            )
            behind = (hidden, self._server.port)
            address = live.host, live.port
            self._gate = LiveGate(address, behind, live.origins, live.viewers)
        except (RuntimeError, OSError) as error:
            raise InputError(
                "live", f"{live.host}:{live.port} cannot be listened at ({error})",
                "correct [live] in robot.toml, or end the program that uses the port",
            ) from None  # fmt: skip
        self.url = f"ws://{live.host}:{self._gate.port}"

    def write(self, time_ns: int, data: bytes, topic: str = TOPIC) -> None:
        self._channels[topic].log(data, log_time=time_ns)

    def finish(self) -> None:
        self._gate.close()
        self._server.stop()


def require_live_package() -> None:
    if importlib.util.find_spec("foxglove") is None:
        raise InputError(
            "--live", "needs the package foxglove-sdk", "pip install 'dropstitch[live]'"
        )


def _schema_json(dof: int) -> bytes:
    return msgspec.json.encode(tick_schema(dof))
