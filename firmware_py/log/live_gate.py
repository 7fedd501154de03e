"""Gate in front of the live view: it refuses foreign origins and caps the viewers.

A page of any web site can open a WebSocket to this PC; its browser names the site in the header
Origin. The server of foxglove-sdk checks neither origin nor number of viewers. So it listens on a
random address of the loopback network, and this gate, in the recorder process, forwards the bytes
of admitted viewers. If a viewer does not read, the gate stops reading from the server for it, and
the server drops the oldest ticks of that viewer.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
from collections.abc import Sequence
from typing import Final

_UNDECIDED: Final = 16
"""Most connections whose request has not arrived yet, in addition to the viewers."""
_HEAD_BYTES: Final = 8192
_HEAD_TIMEOUT_S: Final = 5.0
_PIECE_BYTES: Final = 1 << 16
_END: Final = b"\r\n\r\n"


class LiveGate:
    """Listener that forwards admitted viewers to the server behind it.

    `address`: host and port to listen on; port 0 chooses a free one.
    """

    def __init__(
        self,
        address: tuple[str, int],
        behind: tuple[str, int],
        origins: Sequence[str],
        viewers: int,
    ) -> None:
        self._listener = socket.create_server(address)
        self.port: int = self._listener.getsockname()[1]
        self._behind, self._origins, self._most = behind, frozenset(origins), viewers
        self._connections = self._viewers = 0
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        serving = self._loop.create_task(
            asyncio.start_server(self._admit, sock=self._listener, limit=_HEAD_BYTES)
        )
        self._loop.run_forever()  # `close` may come before the server listens
        serving.cancel()
        tasks = asyncio.all_tasks(self._loop)
        for task in tasks:
            task.cancel()
        self._loop.run_until_complete(asyncio.gather(*tasks, return_exceptions=True))
        self._loop.close()

    def close(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._listener.close()

    async def _admit(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._connections += 1
        try:
            if self._connections <= self._most + _UNDECIDED:
                await self._decide(reader, writer)
        except (OSError, TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
            pass
        except asyncio.CancelledError:
            pass  # by `close`: asyncio would print a traceback for a viewer that is still there
        finally:
            self._connections -= 1
            writer.close()

    async def _decide(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        head = await asyncio.wait_for(reader.readuntil(_END), _HEAD_TIMEOUT_S)
        if not self._is_admitted(head):
            await _refuse(writer, "403 Forbidden", "this origin is not in [live] origins")
        elif self._viewers >= self._most:
            await _refuse(writer, "503 Service Unavailable", "there are [live] viewers already")
        else:
            self._viewers += 1
            try:
                await self._pass_on(head, reader, writer)
            finally:
                self._viewers -= 1

    def _is_admitted(self, head: bytes) -> bool:
        """Whether a request names no origin or a permitted one."""
        lines = head.decode("latin-1").replace("\r", "\n").split("\n")[1:]  # servers take both
        headers = [line.partition(":")[::2] for line in lines]
        origins = [value.strip() for name, value in headers if name.strip().lower() == "origin"]
        return not origins or (len(origins) == 1 and origins[0] in self._origins)

    async def _pass_on(
        self, head: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        server_reader, server_writer = await asyncio.open_connection(*self._behind)
        server_writer.write(head)
        ways = [
            asyncio.ensure_future(_pump(reader, server_writer)),
            asyncio.ensure_future(_pump(server_reader, writer)),
        ]
        try:
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for way in ways:
                way.cancel()
            await asyncio.gather(*ways, return_exceptions=True)
            server_writer.close()


async def _pump(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Forward bytes as fast as the reader takes them."""
    with contextlib.suppress(OSError):
        while data := await reader.read(_PIECE_BYTES):
            writer.write(data)
            await writer.drain()


async def _refuse(writer: asyncio.StreamWriter, status: str, why: str) -> None:
    body = f"dropstitch: {why}\n".encode()
    head = f"HTTP/1.1 {status}\r\nContent-Length: {len(body)}\r\nConnection: close\r\n\r\n"
    writer.write(head.encode() + body)
    await asyncio.wait_for(writer.drain(), _HEAD_TIMEOUT_S)
