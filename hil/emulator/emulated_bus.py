"""Emulated bus: servos that share one line and move a simulated plant.

The caller passes the time with every call, and the plant advances to it. So the same bus runs in
real time behind a port and on a virtual clock.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_py.bus import codec
from firmware_py.bus.codec import BROADCAST, Instruction, Packet, StatusError, word
from firmware_py.bus.registers import Register
from hil.emulator.emulated_servo import EmulatedServo
from hil.emulator.physics import Physics

__all__ = ["EmulatedBus", "Reply"]

Array = NDArray[np.float64]
_SHORTEST_VELOCITY_STEP_S = 5e-4
_LEVEL_OF_INSTRUCTION: dict[int, int] = {Instruction.PING: 0, Instruction.READ: 1}
"""Lowest status return level at which an instruction is answered; 2 if it is not listed."""
_SYNCHRONOUS = (Instruction.SYNC_READ, Instruction.FAST_SYNC_READ, Instruction.SYNC_WRITE)


class Reply(NamedTuple):
    """Status packet before transmission."""

    servo: EmulatedServo
    frame: bytes


class EmulatedBus:
    """Servos on one bus, which execute instructions.

    `on_sample` is called with the time whenever a servo's present position is read.
    """

    def __init__(
        self,
        servos: Sequence[EmulatedServo],
        physics: Physics,
        on_sample: Callable[[int], None] | None = None,
    ) -> None:
        self.servos, self.physics = tuple(servos), physics
        self._now_ns = 0
        self._on_sample = on_sample or (lambda _: None)
        self._registered: dict[int, tuple[int, bytes]] = {}
        self._velocity_rad_s = [0.0] * len(self.servos)
        self._observe()

    @property
    def driven(self) -> bool:
        """Whether any servo has its torque on."""
        return any(servo.torque_on for servo in self.servos)

    def advance(self, now_ns: int) -> None:
        """Advance plant and watchdogs to a time; watchdogs trip at their own times in between."""
        while True:
            due = [(t, s) for s in self.servos if (t := s.watchdog_due_ns) is not None]
            trips = [(t, s) for t, s in due if t <= now_ns]
            target_ns = min((t for t, _ in trips), default=now_ns)
            self._step(target_ns)
            if not trips:
                return
            self._observe()
            for t, servo in trips:
                if t == target_ns:
                    servo.trip_watchdog()

    def resume(self, now_ns: int) -> None:
        """Continue from `now_ns`: the plant stood still while no program was connected."""
        self._now_ns = max(self._now_ns, now_ns)
        for servo in self.servos:
            servo.feed_watchdog(now_ns)

    def _step(self, target_ns: int) -> None:
        step_s = (target_ns - self._now_ns) * 1e-9
        if step_s <= 0.0:
            return
        before = self.physics.angle_rad.tolist()
        self.physics.advance([s.goal_rad for s in self.servos], step_s)
        self._now_ns = target_ns
        if step_s >= _SHORTEST_VELOCITY_STEP_S:
            after = self.physics.angle_rad.tolist()
            self._velocity_rad_s = [(b - a) / step_s for a, b in zip(before, after, strict=True)]

    def _observe(self) -> None:
        """Pass the plant's state to the servos."""
        angles, currents = self.physics.angle_rad.tolist(), self.physics.current_a.tolist()
        for servo, *state in zip(self.servos, angles, self._velocity_rad_s, currents, strict=True):
            servo.observe(*state)

    def execute(self, packet: Packet, now_ns: int) -> list[Reply]:
        """Execute an instruction; return its status packets in the order of transmission."""
        self.advance(now_ns)
        if packet.instruction == Instruction.STATUS:
            return []
        if packet.instruction != Instruction.SYNC_WRITE:  # which reads no present register
            self._observe()
        if packet.intact:
            for servo in self.servos:
                servo.feed_watchdog(now_ns)
            if packet.instruction in _SYNCHRONOUS:
                return self._synchronous(packet, now_ns)
        addressed = [s for s in self.servos if packet.id in (s.id, BROADCAST)]
        answers = [(s, self._single(s, packet, now_ns)) for s in addressed]
        if packet.id == BROADCAST and packet.instruction != Instruction.PING:
            return []
        return [self._reply(s, *answer) for s, answer in answers if self._answers(s, packet)]

    @staticmethod
    def _answers(servo: EmulatedServo, packet: Packet) -> bool:
        level = servo.get(Register.STATUS_RETURN_LEVEL)
        return level >= _LEVEL_OF_INSTRUCTION.get(packet.instruction, 2)

    @staticmethod
    def _reply(servo: EmulatedServo, error: int, data: bytes = b"") -> Reply:
        return Reply(servo, codec.build_status(servo.id, error | servo.alert, data))

    def _synchronous(self, packet: Packet, now_ns: int) -> list[Reply]:
        parameters = packet.parameters
        if packet.id != BROADCAST or len(parameters) < 5:
            return []
        address, length = word(parameters, 0), word(parameters, 2)
        by_id = {s.id: s for s in self.servos}
        if packet.instruction == Instruction.SYNC_WRITE:
            for start in range(4, len(parameters) - length, length + 1):
                servo = by_id.get(parameters[start])
                if servo is not None:
                    servo.write(address, parameters[start + 1 : start + 1 + length])
            return []
        asked = [by_id.get(servo_id) for servo_id in parameters[4:]]
        # Each servo waits for the reply of the one before it (docs/sources.md, "Control tables").
        answering = [s for s in itertools.takewhile(lambda servo: servo is not None, asked) if s]
        if packet.instruction == Instruction.FAST_SYNC_READ:
            return self._together(answering, len(asked), address, length, now_ns)
        return [self._reply(s, *self._read(s, address, length, now_ns)) for s in answering]

    def _together(
        self, servos: Sequence[EmulatedServo], asked: int, address: int, length: int, now_ns: int
    ) -> list[Reply]:
        """Reply of all servos in one packet, sent without gaps after the first return delay."""
        blocks = []
        for servo in itertools.takewhile(lambda s: s.model.table.fast_sync_read, servos):
            error, data = self._read(servo, address, length, now_ns)
            # Assumed: a servo that refuses the read fills its block with zeros.
            blocks.append((servo.id, error | servo.alert, data or bytes(length)))
        return [Reply(servos[0], codec.build_fast_status(asked, blocks))] if blocks else []

    def _single(self, servo: EmulatedServo, packet: Packet, now_ns: int) -> tuple[int, bytes]:
        """Error number and data of one servo's reply."""
        if not packet.intact:
            return StatusError.CRC, b""
        parameters = packet.parameters
        match packet.instruction:
            case Instruction.PING:
                number, version = Register.MODEL_NUMBER, Register.FIRMWARE_VERSION
                data = servo.get(number).to_bytes(2, "little") + bytes((servo.get(version),))
                return StatusError.NONE, data
            case Instruction.READ:
                if len(parameters) != 4:
                    return StatusError.DATA_LENGTH, b""
                return self._read(servo, word(parameters, 0), word(parameters, 2), now_ns)
            case Instruction.WRITE | Instruction.REG_WRITE if len(parameters) < 3:
                return StatusError.DATA_LENGTH, b""
            case Instruction.WRITE:
                return servo.write(word(parameters, 0), parameters[2:]), b""
            case Instruction.REG_WRITE:
                self._registered[servo.id] = (word(parameters, 0), parameters[2:])
                return StatusError.NONE, b""
            case Instruction.ACTION if servo.id in self._registered:
                return servo.write(*self._registered.pop(servo.id)), b""
            case Instruction.REBOOT:
                servo.reboot()
                return StatusError.NONE, b""
        return StatusError.INSTRUCTION, b""

    def _read(
        self, servo: EmulatedServo, address: int, length: int, now_ns: int
    ) -> tuple[int, bytes]:
        if servo.covers(address, length, Register.PRESENT_POSITION):
            self._on_sample(now_ns)
        return servo.read(address, length)
