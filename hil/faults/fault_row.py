"""Row of the fault table: a fault, how it is injected, and the expected outcome."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

from firmware_py.bus.registers import Register
from hil.faults.injection import Injection

TRUST_WORDS: Final = {
    "TRUSTED": "corrections go on",
    "FADING": "corrections begin to fade",
    "LOST": "corrections are gone within 0.2 s",
}
"""Description of the lowest trust in the estimated tip that a run reaches."""


@dataclass(frozen=True)
class Expectation:
    """Outcome that a fault must have."""

    # "finished", "tripped", "signalled", "refused" (before the torque is on), "killed", or
    # "finished or tripped" if it depends on the seed
    ended: str
    # Number of ticks within which the record must show the fault; None if it need not
    within: int | None = None
    # Largest number of missed ticks and ticks without fresh data; None if the robot stops anyway
    lost: int | None = None
    reason: str = ""  # Text that the reason must contain; "|" separates alternatives
    replugs: int = 0  # Number of times that the robot must continue after its port came back
    unlogged: bool = False  # Whether ticks must be missing in the log, and only there
    on_time: bool = False  # Whether no slot may be missed
    # Lowest trust in the estimated tip that the run must reach (`TrustState`); empty for any
    trust: str = ""

    def __str__(self) -> str:
        parts = [self.ended]
        if self.within is not None:
            ticks = "tick" if self.within == 1 else "ticks"
            parts.append(f"seen within {self.within} {ticks}")
        if self.lost is not None:
            ticks = "tick" if self.lost == 1 else "ticks"
            parts.append(f"at most {self.lost} {ticks} lost" if self.lost else "no tick lost")
        if self.unlogged:
            parts.append("only the log suffers")
        if self.on_time:
            parts.append("no slot missed")
        if self.trust:
            parts.append(TRUST_WORDS[self.trust])
        if self.replugs:
            parts.append("goes on from the measured position")
        if self.reason:
            parts.append(f"“{self.reason}”")
        return ", ".join(parts)


@dataclass(frozen=True)
class Setup:
    """Differences between a case and the usual robot, which the defaults describe."""

    latency_s: float = 1e-3  # Latency timer of the USB adapter
    return_delay_s: float = 500e-6
    wrong_baud: bool = False  # Whether the host sends at another baud rate than the servos
    # Goal in pulses that the motion reaches and leaves again, instead of the study's motion
    through_pulse: int | None = None
    lean_rad: float | None = None  # Angle of the arm before the start
    hardware_error: int = 0  # Hardware error bits of the first servo before the start
    rebooted: bool = False  # Whether the first servo was rebooted after that error
    refuses_indirect: bool = False  # Whether the servos refuse indirect addresses
    wrong_model: bool = False  # Whether all servos are of another model than the configuration's
    # Register of the first servo that was changed before the start, and its value
    setting: tuple[Register, int] | None = None
    # Whether servo 2 is of another model, and whether the configuration declares it
    second_model: Literal["as the first", "declared", "undeclared"] = "as the first"
    replug_s: float = 0.0  # `bus.replug_s` of the configuration; 0: the robot stays stopped
    signal: int | None = None  # Signal sent to the robot's process
    freeze_s: float = 0.0  # How long the robot's process is stopped (SIGSTOP)
    recorder_signal: int | None = None  # Signal sent to the recorder's process
    disk_full: bool = False  # Whether the recorder's disk is full
    bundle_swapped: bool = False  # Whether every file of the bundle is overwritten on disk
    # Damage of the bundle before the start, a key of
    # `hil.faults.cases.damaged_bundle.BUNDLE_DAMAGES`; empty for none
    bundle_damage: str = ""
    unplug_s: float | None = None  # How long the port is missing
    port_renamed: bool = False  # Whether the port comes back under another name
    # Reaction to a lost trust in the estimate, for a plan with feedback of the tip; "none" runs the
    # motion without feedback
    feedback: Literal["none", "continue", "stop"] = "none"
    outside: bool = False  # Whether another program sends the goals


USUAL = Setup()


@dataclass(frozen=True)
class FaultRow:
    """One fault, how it is injected, and the outcome that it must have."""

    fault: str
    how: str  # How often or how long
    must: Expectation
    injections: tuple[Injection, ...] = ()  # Empty if the set-up is the fault
    # "virtual"; "socket" if timing matters; "process" for faults of processes
    lines: tuple[str, ...] = ("virtual",)
    setup: Setup = USUAL  # Differences from the usual robot
    models: tuple[int, ...] = (54025, 54024)  # Model numbers of the servos to test
    joints: int = 1  # Least number of joints
