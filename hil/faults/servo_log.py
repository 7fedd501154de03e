"""Log of the emulated servos during a run, independent of the loop's record.

A `LoggedServo` is an emulated servo with faults; it records how long it was driven without an
instruction. A `LoggedBus` records every sample that it sent and every goal that it received. The
loop's record is checked against both.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.bus.codec import Instruction, Packet, StatusError
from firmware_py.bus.registers import Register
from hil.emulator.emulated_bus import EmulatedBus, Reply
from hil.emulator.emulated_servo import EmulatedServo
from hil.emulator.physics import Physics
from hil.faults.faulty_parts import FaultSchedule

Array = NDArray[np.float64]
_HUSHED_ID: Final = 255
LATE_NS: Final = 1_000_000
"""Delay above which a reply counts as late: half of the time that a read leaves for the host.
Computing a reply takes 0.1 ms. [assumed]"""
_READS: Final = (Instruction.SYNC_READ, Instruction.FAST_SYNC_READ)


class LoggedServo(EmulatedServo):
    """Emulated servo with faults."""

    angle_error_rad = 0.0
    current_error_a = 0.0
    frozen = False  # Whether the present registers keep their values
    refuses_indirect = False
    unheard_ns = 0
    _hushed = False

    def hush(self, on: bool) -> None:
        """Remove the servo from the bus, or put it back."""
        self._hushed = on
        self._refresh()

    def _refresh(self) -> None:
        """Refresh as `EmulatedServo` does; a servo off the bus has an unused address."""
        super()._refresh()
        if self._hushed:
            self.id = _HUSHED_ID

    def lose_torque(self) -> None:
        """Switch the torque off without an error."""
        self._release()

    def write(self, address: int, data: bytes) -> int:
        start, _, entries = self.model.table.indirect
        if self.refuses_indirect and start <= address < start + 2 * entries:
            return StatusError.ACCESS
        return super().write(address, data)

    @property
    def live(self) -> bool:
        """Whether the servo drives towards a goal."""
        return self.torque_on and not self.watchdog_tripped

    @property
    def taken_goal_rad(self) -> float:
        """Goal to which the servo drives; NaN if it accepts none."""
        return self.goal_rad if self.live and not self._hushed else math.nan

    @property
    def reported_rad(self) -> float:
        return self.model.angle_rad(self.get(Register.PRESENT_POSITION))

    def observe(self, angle_rad: float, velocity_rad_s: float, current_a: float) -> None:
        """Observe the plant's state with sensor errors; the true angle is kept for a hold."""
        if self.frozen:
            self._angle_rad = angle_rad
            return
        super().observe(angle_rad, velocity_rad_s, current_a)
        if self.angle_error_rad or self.current_error_a:
            hold = self._angle_rad
            super().observe(
                angle_rad + self.angle_error_rad, velocity_rad_s, current_a + self.current_error_a
            )
            self._angle_rad = hold

    def note_silence(self, until_ns: int) -> None:
        """Record the time driven since the last instruction."""
        if self.live:
            self.unheard_ns = max(self.unheard_ns, until_ns - self._fed_ns)

    def feed_watchdog(self, now_ns: int) -> None:
        """Restart the watchdog, unless the servo is off the bus and receives nothing."""
        if not self._hushed:
            self.note_silence(now_ns)
            super().feed_watchdog(now_ns)

    def trip_watchdog(self) -> None:
        if self.watchdog_due_ns is not None:
            self.note_silence(self.watchdog_due_ns)
        super().trip_watchdog()


@dataclass(frozen=True)
class ServoLog:
    """Log of the servos in one run, with n samples and m goals."""

    began_ns: int | None  # Start of the first fault of line or servo
    sample_ns: NDArray[np.int64]  # (n,), times at which angles were reported to the loop
    sample_rad: Array  # (n, dof), reported angles
    goal_ns: NDArray[np.int64]  # (m,), times at which goals were received
    # (m, dof), received goals; NaN if a servo did not accept its goal, infinite in a row that marks
    # torque off
    goal_rad: Array
    stand_rad: Array  # (m, dof), true angles when the goals were received
    watched: bool  # Whether the servos have a bus watchdog
    unheard_ns: int  # Longest time for which a servo was driven without an instruction
    live: bool  # Whether a servo is still driven at the end
    drift_rad: float  # Largest movement of a servo after its last instruction
    # Replies that were written more than `LATE_NS` after they were due; 0 in simulated time
    late_replies: int
    # Replies before which the host preempted the servos' process for more than `LATE_NS`, perhaps
    # before it read the instruction; 0 in simulated time
    held_up_replies: int = 0


class LoggedBus(EmulatedBus):
    """Emulated bus that records its traffic and applies scheduled faults."""

    def __init__(
        self, servos: Sequence[LoggedServo], physics: Physics, script: FaultSchedule
    ) -> None:
        super().__init__(servos, physics)
        self._watched, self._script = tuple(servos), script
        self._sample_ns, self._sample_rad = array("q"), array("d")
        self._goal_ns, self._goal_rad, self._stand_rad = array("q"), array("d"), array("d")
        self._last_heard_rad = self.physics.angle_rad.copy()
        self._late_replies = self._held_up_replies = self._delay_ns = 0

    def execute(self, packet: Packet, now_ns: int) -> list[Reply]:
        running = self.driven
        if running and packet.instruction in _READS:
            self._script.begin_exchange(self._watched, now_ns)
        replies = super().execute(packet, now_ns)
        self._last_heard_rad[:] = self.physics.angle_rad
        if packet.instruction in _READS:
            self._sample_ns.append(now_ns)
            self._sample_rad.extend(servo.reported_rad for servo in self._watched)
        elif packet.instruction == Instruction.SYNC_WRITE and running:
            self._note_goals(now_ns, [servo.taken_goal_rad for servo in self._watched])
        elif running and not self.driven:
            self._note_goals(now_ns, [math.inf] * len(self._watched))
        return replies

    def _note_goals(self, now_ns: int, goals_rad: list[float]) -> None:
        self._goal_ns.append(now_ns)
        self._goal_rad.extend(goals_rad)
        self._stand_rad.extend(self.physics.angle_rad.tolist())

    def resume(self, now_ns: int) -> None:
        """Continue from `now_ns`; the plant stands still in between only if no servo is driven."""
        if self.driven:
            self.advance(now_ns)
        else:
            super().resume(now_ns)

    def note_release(self, due_ns: int, written_ns: int, delay_ns: int = 0) -> None:
        """Count late replies in real time; `delay_ns` is the process's run-queue delay so far."""
        self._held_up_replies += self.driven and delay_ns - self._delay_ns > LATE_NS
        self._delay_ns = delay_ns
        self._late_replies += written_ns - due_ns > LATE_NS

    def log(self, now_ns: int) -> ServoLog:
        """Advance to `now_ns` and return the log."""
        self.advance(now_ns)
        for servo in self._watched:
            servo.note_silence(now_ns)
        dof = len(self._watched)
        return ServoLog(
            began_ns=self._script.began_ns,
            sample_ns=np.array(self._sample_ns, np.int64),
            sample_rad=np.array(self._sample_rad).reshape(-1, dof),
            goal_ns=np.array(self._goal_ns, np.int64),
            goal_rad=np.array(self._goal_rad).reshape(-1, dof),
            stand_rad=np.array(self._stand_rad).reshape(-1, dof),
            watched=all(Register.BUS_WATCHDOG in servo.model.table for servo in self._watched),
            unheard_ns=max(servo.unheard_ns for servo in self._watched),
            live=any(servo.live for servo in self._watched),
            drift_rad=float(np.abs(self.physics.angle_rad - self._last_heard_rad).max()),
            late_replies=self._late_replies,
            held_up_replies=self._held_up_replies,
        )
