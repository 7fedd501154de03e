"""Row of the fault table: a fault, how it is tried, and what must happen."""

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
"""Words for the lowest trust in the estimated tip."""


@dataclass(frozen=True)
class Expectation:
    """Outcome that a fault must have."""

    # "finished", "tripped", "signalled", "refused" (before the torque is on), "killed", or
    # "finished or tripped" where the seed decides
    ended: str
    # Ticks in which the fault must show in the record; None where it need not
    within: int | None = None
    # Ticks without fresh data, or missed, at most; None where the robot stops anyway
    lost: int | None = None
    reason: str = ""  # Words that the reason must hold; "|" parts alternatives
    replugs: int = 0  # Times that the robot must go on after its port was gone
    unlogged: bool = False  # Whether the log must lack ticks, and nothing but the log
    on_time: bool = False  # Whether no slot may be missed
    # Lowest trust in the estimated tip that must be seen (`TrustState`); empty for any
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
    """Differences between a case and the usual robot; the defaults are the usual robot."""

    latency_s: float = 1e-3  # Latency timer of the USB adapter
    return_delay_s: float = 500e-6
    wrong_baud: bool = False  # Whether the host sends at a baud rate that the servos do not use
    # Goal in pulses that the motion reaches and leaves again, instead of the study's motion
    through_pulse: int | None = None
    lean_rad: float | None = None  # Angle at which the arm stands before the start
    hardware_error: int = 0  # Hardware error bits that the first servo has before the start
    rebooted: bool = False  # Whether the first servo was rebooted after that error
    refuses_indirect: bool = False  # Whether the servos refuse indirect addresses
    wrong_model: bool = False  # Whether every servo is of another model than the configuration says
    # Register of the first servo that somebody has changed, and its value
    setting: tuple[Register, int] | None = None
    # Whether servo 2 is of another model, and whether the configuration says so
    second_model: Literal["as the first", "declared", "undeclared"] = "as the first"
    replug_s: float = 0.0  # `bus.replug_s` of the configuration; 0 stays stopped
    signal: int | None = None  # Signal sent to the robot's process
    freeze_s: float = 0.0  # How long the robot's process is stopped (SIGSTOP)
    recorder_signal: int | None = None  # Signal sent to the recorder's process
    disk_full: bool = False  # Whether the recorder can write no further byte
    bundle_swapped: bool = False  # Whether every file of the bundle is overwritten on disk
    # Damage of the bundle before the start, a key of
    # `hil.faults.cases.damaged_bundle.BUNDLE_DAMAGES`; empty for none
    bundle_damage: str = ""
    unplug_s: float | None = None  # How long the port is gone
    port_renamed: bool = False  # Whether the port comes back under another name
    # Whether a plan with feedback of the tip runs in place of the motion, and what follows when the
    # estimate is not trusted
    feedback: Literal["none", "continue", "stop"] = "none"
    outside: bool = False  # Whether another program sends the goals


USUAL = Setup()


@dataclass(frozen=True)
class FaultRow:
    """One fault and how it is tried."""

    fault: str  # Name of the fault; how often or how long
    how: str
    must: Expectation
    injections: tuple[Injection, ...] = ()  # The plan; empty where the set-up is the fault
    # "virtual", and "socket" where there is a timing side; "process" with real processes
    lines: tuple[str, ...] = ("virtual",)
    setup: Setup = USUAL  # What differs from the usual robot
    models: tuple[int, ...] = (54025, 54024)  # Model numbers to try
    joints: int = 1  # How many it needs at least
