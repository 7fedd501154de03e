"""Emulator: line, servos and plant from one specification.

On the virtual line they run in the loop's process. In real time they run in a separate process
(`Emulator`), which exchanges only bytes with the loop.
"""

from __future__ import annotations

import contextlib
import gc
import os
import signal
from array import array
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_py.bus.servo_models import MODELS
from firmware_py.core.errors import InputError
from firmware_py.core.units import DURATION
from firmware_py.system.clock import RealTimeOptions, real_time
from firmware_py.system.kernel_counters import KernelCounters
from hil.emulator.child_process import ChildProcess
from hil.emulator.emulated_bus import EmulatedBus
from hil.emulator.emulated_servo import BAUD_OF_CODE, EmulatedServo
from hil.emulator.line import Line, pty_endpoint, serve_line, socket_endpoint
from hil.emulator.line_faults import FaultPlan
from hil.emulator.physics import FmuPhysics, Physics, RigSource

PRIORITY: Final = 60
"""Real-time priority above the loop's: on a single processor the loop must not delay a reply."""
MAX_PAYLOAD_KG: Final = 20.0
"""Ten times the largest payload of the study."""
MAX_LATENCY_S: Final = 0.255
"""The latency timer of an FTDI adapter is one byte of milliseconds."""


def _no_times() -> NDArray[np.int64]:
    return np.zeros(0, np.int64)


@dataclass(frozen=True)
class Releases:
    """Times of the emulator's replies, one row per packet."""

    due_ns: NDArray[np.int64] = field(default_factory=_no_times)  # (n,), due at the host's end
    written_ns: NDArray[np.int64] = field(default_factory=_no_times)  # (n,), written there
    # (n,), run-queue delay of the emulator since the previous packet
    run_delay_ns: NDArray[np.int64] = field(default_factory=_no_times)

    def run_delay_between_ns(self, start_ns: int, end_ns: int) -> int:
        """Return the run-queue delay of the emulator that may fall into a window."""
        first, last = np.searchsorted(self.written_ns, (start_ns, end_ns))
        return int(self.run_delay_ns[first : last + 1].sum())


@dataclass(frozen=True)
class EmulatorSpecification:
    """Specification of line, servos and plant."""

    source: Path | RigSource  # Twin FMU with one joint per servo, or the rig
    model_number: int = 54024
    ids: tuple[int, ...] = (1,)  # Servo ids, in joint order
    baud: int = 1_000_000
    return_delay_s: float = 500e-6  # Pause of the servos before a status packet
    latency_s: float = 1e-3  # Latency timer of the USB adapter
    payload_kg: float = 0.0
    faults: dict[str, float] = field(default_factory=dict)  # Rate of each kind of line fault
    seed: int = 0  # Seed of the line faults

    def __post_init__(self) -> None:
        if self.baud not in BAUD_OF_CODE.values():
            rates = ", ".join(map(str, BAUD_OF_CODE.values()))
            raise InputError("--baud", f"{self.baud} is no rate of the servo", f"use {rates}")
        if len(set(self.ids)) != len(self.ids) or not all(0 <= i <= 252 for i in self.ids):
            raise InputError("--ids", f"{self.ids} is no set of addresses", "give each once, 0–252")
        if self.model_number not in MODELS:
            raise InputError(
                "--model", f"{self.model_number} is not known", "see dropstitch list servos"
            )
        if not 0.0 <= self.payload_kg <= MAX_PAYLOAD_KG:
            raise InputError(
                "--payload-kg", f"is {self.payload_kg:g}", f"give 0 to {MAX_PAYLOAD_KG:g}"
            )
        if not 0.0 <= self.latency_s <= MAX_LATENCY_S:
            raise InputError(
                "--latency-ms",
                f"is {DURATION.factor * self.latency_s:g}",
                f"give 0 to {DURATION.factor * MAX_LATENCY_S:g}",
            )


class Truth(NamedTuple):
    """True tip of the plant, one row per measurement that the servos sent."""

    time_ns: NDArray[np.int64]  # (n,), sampling time
    tip_m: NDArray[np.float64]  # (n, 3), true tip at that time


class TruthLog:
    """Record of the true tip at every read of a present position."""

    def __init__(self, physics: Physics) -> None:
        self._physics = physics
        self._time_ns, self._tip_m = array("q"), array("d")

    def note(self, time_ns: int) -> None:
        """Record the tip, once for all replies to the same instruction."""
        if self._time_ns and self._time_ns[-1] == time_ns:
            return
        self._time_ns.append(time_ns)
        self._tip_m.extend(self._physics.tip_m.tolist())

    def truth(self) -> Truth:
        return Truth(np.array(self._time_ns, np.int64), np.array(self._tip_m).reshape(-1, 3))


def open_physics(source: Path | RigSource, dof: int, payload_kg: float = 0.0) -> Physics:
    """Open a twin FMU or a rig in its initial state."""
    if isinstance(source, Path):
        return FmuPhysics(source, dof, payload_kg)
    from hil.emulator.rig_physics import RigPhysics  # loads MuJoCo

    return RigPhysics(source, dof, payload_kg)


def build_line(specification: EmulatorSpecification) -> tuple[Line, TruthLog]:
    """Build line, servos and plant; return the line and the record of the true tip.

    The plant is in its initial state at time zero.
    """
    spec = specification
    physics = open_physics(spec.source, len(spec.ids), spec.payload_kg)
    log = TruthLog(physics)
    servos = [
        EmulatedServo(MODELS[spec.model_number], servo_id, spec.baud, spec.return_delay_s)
        for servo_id in spec.ids
    ]
    bus = EmulatedBus(servos, physics, on_sample=log.note)
    return Line(bus, spec.latency_s, FaultPlan(spec.faults, spec.seed)), log


class EmulatorOutcome(NamedTuple):
    """Record of an emulator: true tip, release times of replies, injected faults by kind."""

    truth: Truth
    releases: Releases
    faults: dict[str, int]


def _run(
    pipe: Connection,
    spec: EmulatorSpecification,
    kind: Literal["pty", "socket"],
    path: Path,
    cpu: int,
) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a Ctrl-C in the terminal stops the loop
    due, written, delays = array("q"), array("q"), array("q")
    with real_time(RealTimeOptions(priority=PRIORITY, cpu=cpu)), contextlib.ExitStack() as stack:
        counters = KernelCounters()
        seen_ns = counters.run_delay_ns()

        def note_release(due_ns: int, written_ns: int) -> None:
            nonlocal seen_ns
            delay_ns = counters.run_delay_ns()
            due.append(due_ns)
            written.append(written_ns)
            delays.append(delay_ns - seen_ns)
            seen_ns = delay_ns

        endpoint = pty_endpoint() if kind == "pty" else socket_endpoint(path, pipe.fileno())
        name, connect = stack.enter_context(endpoint)
        line, log = build_line(spec)
        gc.freeze()
        pipe.send(name)
        while (fd := connect()) is not None and serve_line(line, fd, pipe.fileno(), note_release):
            pass
    releases = Releases(*(np.array(column, np.int64) for column in (due, written, delays)))
    with contextlib.suppress(BrokenPipeError):
        pipe.send(EmulatorOutcome(log.truth(), releases, dict(line.faults.injected)))


class Emulator(ChildProcess[EmulatorOutcome]):
    """Emulated servos in a separate process; `name` is that of their port."""

    def __init__(
        self,
        specification: EmulatorSpecification,
        kind: Literal["pty", "socket"],
        directory: Path,
        cpu: int,
    ) -> None:
        # An unusable FMU is reported here, because the other process has no terminal.
        if isinstance(specification.source, Path):
            dof, payload_kg = len(specification.ids), specification.payload_kg
            FmuPhysics(specification.source, dof, payload_kg).fmu.close()
        line = directory / f"line-{os.getpid()}"
        super().__init__("emulator", _run, specification, kind, line, cpu)
        self.name: str = self.started


def serve_forever(
    specification: EmulatorSpecification,
    kind: Literal["pty", "socket"],
    path: Path,
    announce: Callable[[str], None],
) -> None:
    """Serve emulated servos in this process until it is interrupted.

    `announce` is called with the name of the port as soon as it is open.
    """
    never, held = os.pipe()
    endpoint = pty_endpoint() if kind == "pty" else socket_endpoint(path, never)
    try:
        with endpoint as (name, connect):
            line, _ = build_line(specification)
            announce(name)
            while (fd := connect()) is not None and serve_line(line, fd, never):
                pass
    finally:
        os.close(never)
        os.close(held)
