"""Port to the servos: packets sent and received under a deadline, and access to single registers.

Unlike dynamixel-sdk 4.1.0 as shipped (docs/sources.md, "Dynamixel SDK"):

- A read blocks in the kernel until bytes arrive. The SDK polls, which uses 13–31 % of a processor
  and under SCHED_FIFO keeps the kernel's worker from delivering the bytes.
- The deadline of the caller is the only timeout. In the SDK one lost answer costs 34 ms.
- The deadline also holds while bytes keep coming. After it the port is read once more, for bytes
  that arrived in time, and an exchange takes `EXCHANGE_BYTES` at most. The SDK reads a flood for
  ever.
- Time is monotonic, or simulated. In the SDK it is the wall clock.
- A late answer is recognised by its length. The SDK takes the answer to an earlier instruction for
  the present one: the CRC for data, or a read's answer for the confirmation of a write.
"""

from __future__ import annotations

import contextlib
from typing import Final

from firmware_py.bus import codec
from firmware_py.bus.codec import ALERT, ERROR_NUMBER, Instruction, Packet, PacketSearch
from firmware_py.bus.registers import RegisterField
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.bus.transport import Transport
from firmware_py.system.clock import Clock

EXCHANGE_BYTES: Final = 4096
"""Most bytes of one exchange; a line of 4 Mbaud delivers 3200 in the 8 ms of a tick."""
_READ_SIZE: Final = 1024
"""Bytes of one read. They are parsed without a look at the clock, which takes 1 ms at worst."""
_LONGEST_WAIT_NS: Final = 1_000_000_000

SETUP_TIMEOUT_NS: Final = 50_000_000
"""Longest wait for one answer outside the loop."""
SETUP_ATTEMPTS: Final = 3


class DeadlinePort:
    """Packets over a `Transport`, bounded by `deadline_ns`, which the caller sets.

    `wait_ns` is the total time spent waiting for bytes.
    """

    def __init__(self, transport: Transport, clock: Clock) -> None:
        self.deadline_ns = 0
        self.wait_ns = 0
        self._transport, self._clock = transport, clock
        self._search = PacketSearch(host=True)
        self._begin_exchange()

    def _begin_exchange(self) -> None:
        self._search.pending, self._room, self._read_late = b"", EXCHANGE_BYTES, False

    def replace(self, transport: Transport) -> None:
        """Continue with another transport after a disconnect."""
        self._transport = transport
        self._begin_exchange()

    def close(self) -> None:
        self._transport.close()

    def request(self, packet: bytes) -> bool:
        """Send an instruction that expects an answer, and drop all bytes received before it.

        Returns whether the device accepted it; raises OSError after a disconnect, as all methods.
        """
        self._begin_exchange()
        self._transport.discard_input()
        return self.send(packet)

    def send(self, packet: bytes) -> bool:
        """Send an instruction that no servo answers; return whether the device accepted it."""
        return self._transport.write(packet) == len(packet)

    def receive(self, *, common: bool = False) -> tuple[Packet | None, BusStatus]:
        """Receive the next status packet; bytes before it are dropped.

        `common`: the reply to a fast sync read. The status is OK, TIMEOUT or CORRUPT: an answer
        that is damaged, or incomplete at the deadline. Only with OK there is a packet.
        """
        search = self._search
        read_once = bool(search.pending)  # bytes that came with the last packet count as a read
        while (packet := search.next(common=common)) is None:
            if read_once and self._is_over():
                status = BusStatus.CORRUPT if search.pending else BusStatus.TIMEOUT
                search.pending = b""
                return None, status
            self._read()
            read_once = True
        return (packet, BusStatus.OK) if packet.intact else (None, BusStatus.CORRUPT)

    def _read(self) -> None:
        """Wait for bytes until the deadline.

        The first read after the deadline takes the bytes that are there, further ones none.
        """
        start_ns = self._clock.now_ns()
        late = not 0 < self.deadline_ns - start_ns <= _LONGEST_WAIT_NS
        if (late and self._read_late) or self._room <= 0:
            return
        self._read_late = late
        received = self._transport.read(min(_READ_SIZE, self._room), self.deadline_ns)
        self._search.pending += received
        self._room -= len(received)
        self.wait_ns += self._clock.now_ns() - start_ns

    def _is_over(self) -> bool:
        """Whether the exchange is over: deadline, clock set back, or too many bytes."""
        remaining_ns = self.deadline_ns - self._clock.now_ns()
        return self._room <= 0 or not 0 < remaining_ns <= _LONGEST_WAIT_NS


class RegisterAccess:
    """Access to single registers outside the loop, with retries; `alert` collects alert bits."""

    def __init__(self, port: DeadlinePort, clock: Clock) -> None:
        self._port, self._clock = port, clock
        self.alert = False

    def read_once(self, id_: int, cell: RegisterField) -> int | None:
        """Read a register once, within the port's deadline; None if that fails or is refused."""
        answer = self._exchange(codec.build_read(id_, cell.address, cell.size), id_, cell.size)
        if answer is None or len(answer) != 1 + cell.size:
            return None
        return cell.decode(answer, 1)

    def ping(self, id_: int) -> bool:
        """Return whether a servo answers a ping, which works at every status return level."""
        self._port.deadline_ns = self._clock.now_ns() + SETUP_TIMEOUT_NS
        with contextlib.suppress(OSError):
            return self._exchange(codec.build(id_, Instruction.PING), id_, None) is not None
        return False

    def get(self, id_: int, cell: RegisterField) -> int | None:
        """Read a register in up to three attempts; None if all fail or the port is disconnected."""
        with contextlib.suppress(OSError):
            for _ in range(SETUP_ATTEMPTS):
                self._port.deadline_ns = self._clock.now_ns() + SETUP_TIMEOUT_NS
                if (raw := self.read_once(id_, cell)) is not None:
                    return raw
        return None

    def put(self, id_: int, cell: RegisterField, raw: int) -> bool:
        """Write a register in up to three attempts; return whether the servo confirmed it."""
        instruction = codec.build_write(id_, cell.address, cell.encode(raw))
        with contextlib.suppress(OSError):
            for _ in range(SETUP_ATTEMPTS):
                self._port.deadline_ns = self._clock.now_ns() + SETUP_TIMEOUT_NS
                if (answer := self._exchange(instruction, id_, 0)) is None:
                    continue
                self.alert |= bool(answer[0] & ALERT)
                if not answer[0] & ERROR_NUMBER:
                    return True
        return False

    def _exchange(self, instruction: bytes, id_: int, size: int | None) -> bytes | None:
        """Send an instruction; return error byte and data of its answer, None without one.

        `size`: bytes of data in a good answer, None for any number. An answer of another size
        belongs to an earlier instruction, unless it refuses a read. A write takes none but an
        answer without data, so that a late answer to a read never confirms it.
        """
        if not self._port.request(instruction):
            return None
        while True:
            packet, _ = self._port.receive()
            if packet is None:
                return None
            answer = packet.parameters
            if packet.id != id_:
                continue
            if size is None or len(answer) == 1 + size or (size and answer[0] & ERROR_NUMBER):
                return answer
