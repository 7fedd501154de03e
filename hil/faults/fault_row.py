"""Row of the fault table: a fault, how it is injected, the expected outcome, what it proves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

from firmware_py.bus.registers import Register
from hil.faults.fault_kinds import FAULT_KINDS, FaultKind

_TRUST_WORDS: Final = {
    "TRUSTED": "corrections go on",
    "FADING": "corrections begin to fade",
    "LOST": "corrections are gone within 0.2 s",
}


LINES: Final = ("virtual", "socket", "process")
"""Simulated time; a socket, where timing matters; real processes."""


@dataclass(frozen=True)
class Injection:
    """One fault of a kind of `FAULT_KINDS`, whose start the seed sets."""

    kind: str
    # Number of exchanges in a row; ticks for a fault of the host, writes to each servo if unheard
    times: int = 1
    # Delay in s, error in rad or A, hardware error bits, signal number, depending on the kind
    value: float = 0.0
    joint: int | None = None  # Joint with the fault, from 0; None for all
    after: int = 0  # Exchanges from the start of the schedule to the start of this fault

    def __post_init__(self) -> None:
        if self.kind not in FAULT_KINDS:
            raise ValueError(f"no fault {self.kind!r}: choose from {', '.join(FAULT_KINDS)}")

    @property
    def does(self) -> FaultKind:
        return FAULT_KINDS[self.kind]

    def active(self, count: int, start: int) -> bool:
        """Whether the fault acts in an exchange or tick, in a schedule that starts at `start`."""
        return start + self.after <= count < start + self.after + self.times


Outcome = Literal["finished", "tripped", "signalled", "refused", "killed", "finished or tripped"]
"""End of a run: "refused" is before the torque is on, the last one depends on the seed."""


@dataclass(frozen=True)
class Expectation:
    """Outcome that a fault must have."""

    ended: Outcome
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
        parts: list[str] = [self.ended]
        if self.within is not None:
            ticks = "tick" if self.within == 1 else "ticks"
            parts.append(f"detected within {self.within} {ticks}")
        if self.lost is not None:
            ticks = "tick" if self.lost == 1 else "ticks"
            parts.append(f"at most {self.lost} {ticks} lost" if self.lost else "no tick lost")
        if self.unlogged:
            parts.append("only the log suffers")
        if self.on_time:
            parts.append("no slot missed")
        if self.trust:
            parts.append(_TRUST_WORDS[self.trust])
        if self.replugs:
            parts.append("goes on from the measured position")
        if self.reason:
            parts.append(f"“{self.reason}”")
        return ", ".join(parts)


@dataclass(frozen=True)
class Setup:
    """Differences between a case and the usual robot, which the defaults describe."""

    latency_s: float = 1e-3  # Latency timer of the USB adapter
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
    port_renamed: bool = False  # Whether the port comes back under another name
    # Reaction to a lost trust in the estimate, for a plan with feedback of the tip; "none" runs the
    # motion without feedback
    feedback: Literal["none", "continue", "stop"] = "none"


USUAL: Final = Setup()


@dataclass(frozen=True)
class FaultRow:
    """One fault, how it is injected, the outcome that it must have, and what this proves."""

    fault: str
    how: str  # How often or how long
    must: Expectation
    injections: tuple[Injection, ...] = ()  # Empty if the set-up is the fault
    lines: tuple[str, ...] = ("virtual",)
    setup: Setup = USUAL  # Differences from the usual robot
    models: tuple[int, ...] = (54025, 54024)  # Model numbers of the servos to test
    joints: int = 1  # Least number of joints
    proves: tuple[str, ...] = ()  # Requirements of safety_requirements.toml

    def __post_init__(self) -> None:
        if unknown := set(self.lines) - set(LINES):
            raise ValueError(
                f"{self.fault}: no line {unknown.pop()!r}: choose from {', '.join(LINES)}"
            )
        for injection in self.injections:
            if (injection.joint or 0) >= self.joints:
                at = f"joint {injection.joint} of {self.joints}"
                raise ValueError(f"{self.fault}: {at}: joints count from 0, see `joints`")
            of_process = injection.does.where in ("process", "bundle")
            if of_process != (self.lines == ("process",)):
                lines = "the line 'process' alone" if of_process else "another line than 'process'"
                raise ValueError(f"{self.fault}: a fault {injection.kind!r} needs {lines}")

    def injects(self, where: str) -> bool:
        return any(injection.does.where == where for injection in self.injections)
