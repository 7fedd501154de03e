"""Fault table: each fault, how it is injected, and the outcome that it must have.

Some conditions hold in every case (`hil.faults.fault_verdict`):

- No servo with a watchdog is driven without an instruction for longer than the watchdog's timeout.
- No goal jumps.
- No data counts as fresh unless the servo sent it in the same tick.
- At the end no servo is driven.
- The torque of a robot that was refused was never on.
"""

from __future__ import annotations

import math
from dataclasses import replace
from signal import (
    SIGHUP,
    SIGKILL,
    SIGPIPE,
    SIGQUIT,
    SIGSTOP,
    SIGTERM,
    SIGTSTP,
    SIGUSR1,
    SIGUSR2,
    Signals,
)
from typing import Final

from firmware_py.bus.registers import HARDWARE_ERRORS, Register
from firmware_py.safety.states import UNRELEASED
from hil.emulator.line_faults import UNHEARD
from hil.faults.fault_row import Expectation, FaultRow, Setup
from hil.faults.feedback_rows import FEEDBACK
from hil.faults.goal_rows import GOALS
from hil.faults.injection import FOREVER, Injection

HOUR_S: Final = 3600.0
HARMLESS: Final = Expectation("finished", lost=0)
RECOVERED: Final = Expectation("finished", within=1, lost=0)
"""The retry in the same tick gets the data."""
BOTH_READS: Final = 2
"""Exchanges of a tick whose first read fails: the read and its retry."""
BOTH: Final = ("virtual", "socket")
LEGACY: Final = 54024
ALL_MODELS: Final = (54025, LEGACY)
WATCHED: Final = (54025,)
"""Models with a bus watchdog; the legacy PRO (54024) has none."""
UNNOTICED_TICKS: Final = 90
"""Ticks within which the loop detects that a servo without indirect addresses is off. Only the
following error shows it, which is small near a turning point of the motion."""
FROZEN_TICKS: Final = 60
"""Ticks within which frozen feedback is detected: `limits.frozen_ticks`, and those in which the
goal moves little near a turning point."""
_STALE: Final = "no fresh data for 3 ticks"
_STALLED: Final = "slots missed in a row|its watchdog stopped it"


def _rides(ticks: int) -> Expectation:
    return Expectation("finished", within=1, lost=ticks)


def _loses(ticks: int) -> Expectation:
    return Expectation("finished", lost=ticks)


def _tripped(reason: str, within: int) -> Expectation:
    return Expectation("tripped", within=within, reason=reason)


def _flooded(reason: str, within: int) -> Expectation:
    return Expectation("tripped", within=within, reason=reason, on_time=True)


def _signalled(number: Signals) -> Expectation:
    return Expectation("signalled", reason=number.name)


def _refused(reason: str) -> Expectation:
    return Expectation("refused", reason=reason)


def _unheard(
    fault: str, kind: str, value: float = 0.0, lines: tuple[str, ...] = ("virtual",)
) -> list[FaultRow]:
    """Fault that loses the reply: up to two ticks in a row are tolerated, three bring a stop.

    A failed read is retried once in the same tick, so only two faults lose a tick.
    """
    once = Injection(kind, 1, value)
    one, two, three = (Injection(kind, ticks * BOTH_READS, value) for ticks in (1, 2, 3))
    return [
        FaultRow(fault, "once", RECOVERED, (once,), lines),
        FaultRow(fault, "both reads of a tick", _rides(1), (one,), lines),
        FaultRow(fault, "both reads of two ticks", _rides(2), (two,)),
        FaultRow(fault, "both reads of three ticks", _tripped(_STALE, 1), (three,)),
    ]


def _tolerated(
    fault: str, kind: str, value: float = 0.0, lines: tuple[str, ...] = ("virtual",)
) -> list[FaultRow]:
    once, burst = Injection(kind, 1, value), Injection(kind, 10, value)
    return [
        FaultRow(fault, "once", HARMLESS, (once,), lines),
        FaultRow(fault, "ten in a row", HARMLESS, (burst,)),
    ]


def _persistent(fault: str, kind: str, value: float, reason: str) -> list[FaultRow]:
    """Outlier: tolerated once, a controlled stop at the third sample in a row."""
    return [
        FaultRow(fault, "once", HARMLESS, (Injection(kind, 1, value),)),
        FaultRow(fault, "three in a row", _tripped(reason, 3), (Injection(kind, 3, value),)),
    ]


def _changed(
    how: str, register: Register, raw: int, reason: str, models: tuple[int, ...] = ALL_MODELS
) -> FaultRow:
    """Servo with a setting other than the plant assumes."""
    setup = Setup(setting=(register, raw))
    return FaultRow("changed servo setting", how, _refused(reason), setup=setup, models=models)


def _process(
    fault: str, how: str, must: Expectation, setup: Setup, models: tuple[int, ...] = WATCHED
) -> FaultRow:
    return FaultRow(fault, how, must, (), ("process",), setup, models)


def _unfit_bundle(damage: str, reason: str) -> FaultRow:
    """Bundle that is refused before any of its code runs; `damage` is a key of `BUNDLE_DAMAGES`."""
    return _process("unfit bundle", damage, _refused(reason), Setup(bundle_damage=damage))


_KILLED: Final = Expectation("killed")
_UNLOGGED: Final = Expectation("finished", lost=0, unlogged=True)
_BACK: Final = Expectation(  # the motion continues to its end, but a fault denies the success
    "tripped", within=1, reason="then the port was back; then the motion is over", replugs=1
)

LINE: Final = (
    *_unheard("lost reply", "lost", lines=BOTH),
    *_tolerated("reply late by 1 ms", "late", 1e-3, BOTH),
    *_tolerated("reply late by 5 ms", "late", 5e-3, BOTH),
    *_unheard("reply late by a period", "late", 17e-3, BOTH),
    *_unheard("reply late by 20 ms", "late", 20e-3, BOTH),
    *_tolerated("duplicated reply", "duplicated"),
    *_unheard("bit flip in header", "flip in header"),
    *_unheard("bit flip in length", "flip in length"),
    *_unheard("bit flip in payload", "flip in payload"),
    *_unheard("bit flip in CRC", "flip in CRC"),
    *_unheard("truncation", "truncated"),
    *_tolerated("noise before a packet", "noise"),
    *_unheard("reply from another id", "other id"),
    FaultRow("babbling line", "4 kB before each reply", _flooded(_STALE, 1),
        (Injection("babble", FOREVER, 4e-3),), BOTH),
    FaultRow("flood of bytes", "at the rate of the fastest line, 4 Mbaud",
        _flooded(_STALE, 1), (Injection("flood", FOREVER, 0.4e6),)),
    FaultRow("flood of bytes", "without a pause, as from another process",
        _flooded(_STALE, 1), (Injection("flood", FOREVER, 1e9),)),
    FaultRow("latency timer 16", "from the start", _refused("latency timer"),
        lines=BOTH, setup=Setup(latency_s=16e-3)),
    FaultRow("wrong baud", "from the start", _refused("baud rate is the servo's"),
        setup=Setup(wrong_baud=True)),
    FaultRow("return delay at its default", "from the start", HARMLESS, lines=BOTH,
        setup=Setup(return_delay_s=500e-6)),
    FaultRow("goal whose bytes need stuffing", "−131073 pulses", HARMLESS,
        setup=Setup(through_pulse=-131_073), models=WATCHED),
)  # fmt: skip

SERVO: Final = (
    FaultRow("one servo silent", "once", RECOVERED, (Injection("silent", 1, joint=1),), joints=2),
    FaultRow("one servo silent", "both reads of a tick", _rides(1),
        (Injection("silent", BOTH_READS, joint=1),), joints=2),
    FaultRow("one servo silent", "for good", _tripped(_STALE, 1),
        (Injection("silent", FOREVER, joint=1),), joints=2),
    FaultRow("both servos silent", "both reads of two ticks", _rides(2),
        (Injection("silent", 2 * BOTH_READS),), joints=2),
    FaultRow("both servos silent", "for good", _tripped(_STALE, 1), (Injection("silent", FOREVER),),
        joints=2),
    *(
        FaultRow("hardware error", name, _tripped(name, 1),
            (Injection("hardware error", 1, 1 << bit),))
        for bit, name in enumerate(HARDWARE_ERRORS)
    ),
    FaultRow("shutdown, then started again", "without a reboot",
        _refused("reports a hardware error (overload)"),
        setup=Setup(hardware_error=1 << 5)),
    FaultRow("shutdown, then started again", "after a reboot", HARMLESS,
        setup=Setup(hardware_error=1 << 5, rebooted=True)),
    FaultRow("reboot in motion", "once", _tripped("its torque went off", 1),
        (Injection("reboot"),)),
    FaultRow("reboot in motion", "once, of servos that refuse indirect addresses",
        _tripped("repeats angle and current|away from its goal", UNNOTICED_TICKS),
        (Injection("reboot"),),
        setup=Setup(refuses_indirect=True)),
    FaultRow("torque lost", "once", _tripped("its torque went off", 1), (Injection("torque"),)),
    FaultRow("watchdog trip", "once", _tripped("its watchdog stopped it", 1),
        (Injection("watchdog"),), models=WATCHED),
    FaultRow("arm leans at the start", "by 20°", HARMLESS, setup=Setup(lean_rad=0.349)),
    FaultRow("arm leans at the start", "by −34°, just inside limits.angle_rad", HARMLESS,
        setup=Setup(lean_rad=-0.595)),
    FaultRow("arm leans at the start", "by 35°, outside", _refused("move it by hand"),
        setup=Setup(lean_rad=0.611)),
    FaultRow("wrong model number", "all servos", _refused("not"),
        setup=Setup(wrong_model=True)),
    FaultRow("legacy and new PRO on one bus", "declared", _refused("different control"),
        setup=Setup(second_model="declared"), joints=2),
    FaultRow("legacy and new PRO on one bus", "undeclared", _refused("servo 2 is"),
        setup=Setup(second_model="undeclared"), joints=2),
    _changed("Drive Mode reverse", Register.DRIVE_MODE, 1, "has Drive Mode 1 (reverse)", WATCHED),
    _changed("Drive Mode torque on by a goal", Register.DRIVE_MODE, 8, "has Drive Mode 8", WATCHED),
    _changed("Homing Offset", Register.HOMING_OFFSET, 1000, "has a Homing Offset of"),
    _changed("Position P Gain", Register.POSITION_P_GAIN, 400, "has Position P Gain 400"),
    _changed("Velocity I Gain", Register.VELOCITY_I_GAIN, 14, "has Velocity I Gain 14"),
    _changed("Status Return Level 0", Register.STATUS_RETURN_LEVEL, 0,
        "answers a ping but no read: its Status Return Level is 0"),
    _changed("Status Return Level 1", Register.STATUS_RETURN_LEVEL, 1,
        "has Status Return Level 1: it confirms no write"),
    FaultRow("changed servo setting", "profile of acceleration, which is removed", HARMLESS,
        setup=Setup(setting=(Register.PROFILE_ACCELERATION, 10))),
    *_persistent("encoder jump of 0.3 rad", "encoder", 0.3, "away from its goal"),
    *_persistent("current spike of 12 A", "current", 12.0, "draws"),
    FaultRow("frozen feedback", "for five samples", HARMLESS, (Injection("frozen", 5),)),
    FaultRow("frozen feedback", "for good", _tripped("repeats angle and current", FROZEN_TICKS),
        (Injection("frozen", FOREVER),)),
    FaultRow("frozen feedback", "for good, of one servo",
        _tripped("joint 2 repeats angle and current", FROZEN_TICKS),
        (Injection("frozen", FOREVER, joint=1),), joints=2),
)  # fmt: skip

HOST: Final = (
    *_persistent("NaN out of the predictor", "predictor", math.nan, "predicted tip"),
    *_persistent("infinity out of the predictor", "predictor", math.inf, "predicted tip"),
    *_persistent("NaN out of the estimator", "estimator", math.nan, "Deformation Index"),
    *_persistent("infinity out of the estimator", "estimator", math.inf, "Deformation Index"),
    FaultRow("predictor taking 30 ms", "once", Expectation("finished", within=2, lost=2),
        (Injection("slow predictor", 1, 30e-3),), BOTH),
    FaultRow("predictor taking 30 ms", "for good", _tripped("too slow for its period", 2),
        (Injection("slow predictor", FOREVER, 30e-3),), BOTH),
    FaultRow("host stall of 5 ms", "once", HARMLESS, (Injection("stall", 1, 5e-3),), BOTH),
    FaultRow("host stall of 20 ms", "once", Expectation("finished", within=2, lost=2),
        (Injection("stall", 1, 20e-3),), BOTH),
    FaultRow("host stall of 100 ms", "once", _tripped(_STALLED, 2),
        (Injection("stall", 1, 100e-3),), BOTH),
    FaultRow("garbage-collector pressure", "for good", HARMLESS, (Injection("garbage", FOREVER),),
        ("socket",), models=WATCHED),
    FaultRow("clock stepped by +1 h", "once", _tripped("slots missed in a row", 2),
        (Injection("clock", FOREVER, HOUR_S),)),
    FaultRow("clock stepped by −1 h", "once", _tripped("the clock was set back", 2),
        (Injection("clock", FOREVER, -HOUR_S),)),
    FaultRow("unplug", "for good", _tripped("no fresh data for 3 ticks (PORT_GONE)", 1),
        (Injection("port", FOREVER, math.inf),)),
    FaultRow("unplug and replug", "configured to stay stopped",
        _tripped("no fresh data for 3 ticks (PORT_GONE)", 1), (Injection("port", FOREVER, 1.2),)),
    FaultRow("unplug and replug", "configured to go on", _BACK,
        (Injection("port", FOREVER, 1.2),), setup=Setup(replug_s=5.0)),
)  # fmt: skip

TOGETHER: Final = (
    FaultRow("together: lost, flipped, truncated, noise", "one after the other", RECOVERED,
        (Injection("lost"), Injection("flip in payload", after=3), Injection("truncated", after=6),
         Injection("noise", after=8), Injection("flip in length", after=9)), BOTH),
    FaultRow("together: late by a period and encoder jump", "both reads of two ticks, then once",
        _rides(2),
        (Injection("late", 2 * BOTH_READS, 17e-3),
         Injection("encoder", 1, 0.3, after=2 * BOTH_READS))),
    FaultRow("together: lost reply in a stall of 20 ms", "once", _rides(2),
        (Injection("lost"), Injection("stall", 1, 20e-3))),
    FaultRow("together: lost replies in a stall of 20 ms", "both reads of a tick", _rides(3),
        (Injection("lost", BOTH_READS), Injection("stall", 1, 20e-3))),
    FaultRow("together: lost replies in a stall of 60 ms", "both reads of two ticks",
        _tripped("no fresh data|missed", 2),
        (Injection("lost", 2 * BOTH_READS), Injection("stall", 1, 60e-3))),
    FaultRow("together: one silent, the other overheats", "for good",
        _tripped(f"{_STALE}|overheating", 1),
        (Injection("silent", FOREVER, joint=1), Injection("hardware error", 1, 4, joint=0)),
        joints=2),
    FaultRow("together: NaN out of the predictor, then lost", "two and one", HARMLESS,
        (Injection("predictor", 2, math.nan), Injection("lost", after=2))),
    FaultRow("together: unplugged during a bad stretch", "configured to go on", _BACK,
        (Injection("flip in payload", 2 * BOTH_READS), Injection("port", FOREVER, 1.0, after=2)),
        setup=Setup(replug_s=5.0)),
    FaultRow("together: 5 % each of six faults of the line", "all along",
        Expectation("finished or tripped"),
        tuple(Injection(kind, 1, 17e-3, after=after) for after, kind in enumerate(
            ("lost", "late", "duplicated", "flip in payload", "truncated", "noise") * 4))),
)  # fmt: skip


def _while_stopping(
    fault: str, how: str, reason: str, *injections: Injection, joints: int = 1
) -> FaultRow:
    """Faults that begin five ticks after the request of a controlled stop.

    The emulated line has no faults while no servo is driven. So with one servo, the retry of torque
    off is always confirmed.
    """
    later = (replace(injection, after=5) for injection in injections)
    must = _tripped(f"a request; then {reason}", 1)
    return FaultRow(fault, how, must, (Injection("request"), *later), joints=joints)


STOPPING: Final = (
    _while_stopping("overload while stopping", "once", "a servo raises an alert (overload",
        Injection("hardware error", 1, 1 << 5)),
    _while_stopping("torque lost while stopping", "once",
        "a servo raises an alert (its torque went off)", Injection("torque")),
    _while_stopping("current of 12 A while stopping", "for good", "joint 1 draws",
        Injection("current", FOREVER, 12.0)),
    _while_stopping("lost replies while stopping", "for good",
        f"{_STALE} (TIMEOUT); then {UNRELEASED}", Injection("lost", FOREVER), joints=2),
    _while_stopping("torque off unheard, late replies", "the first to each servo", _STALE,
        Injection("late", FOREVER, 12e-3), Injection(UNHEARD, 1)),
    _while_stopping("unplug while stopping", "for good",
        f"{_STALE} (PORT_GONE); then {UNRELEASED}", Injection("port", FOREVER, math.inf)),
)  # fmt: skip

PROCESS: Final = (
    *(
        _process(f"{number.name} in motion", "once", _signalled(number), Setup(signal=number))
        for number in (SIGTERM, SIGHUP, SIGQUIT, SIGUSR1, SIGUSR2, SIGPIPE, SIGTSTP)
    ),
    _process("SIGHUP in motion", "once, legacy PRO", _signalled(SIGHUP), Setup(signal=SIGHUP),
             (LEGACY,)),
    _process("SIGKILL in motion", "once", _KILLED, Setup(signal=SIGKILL)),
    _process("SIGKILL in motion", "once, legacy PRO", _KILLED, Setup(signal=SIGKILL), (LEGACY,)),
    _process("host stall of 5 ms", "process stopped", _loses(1), Setup(freeze_s=5e-3)),
    _process("host stall of 20 ms", "process stopped", _loses(3), Setup(freeze_s=20e-3)),
    _process("host stall of 100 ms", "process stopped", _tripped(_STALLED, 2), Setup(freeze_s=0.1)),
    _process("recorder dead", "killed", _UNLOGGED, Setup(recorder_signal=SIGKILL)),
    _process("recorder blocked", "stopped for good", _UNLOGGED, Setup(recorder_signal=SIGSTOP)),
    _process("full disk", "no byte more from now on", _UNLOGGED, Setup(disk_full=True)),
    _process("bundle swapped on disk", "every file", HARMLESS, Setup(bundle_swapped=True)),
    _unfit_bundle("changed file", "predictor.onnx: does not match the hash"),
    _unfit_bundle("unnamed file", "names no predictor.onnx"),
    _unfit_bundle("file outside", "is no file of a bundle"),
    _unfit_bundle("other golden ticks", "the bundle expects"),
    _unfit_bundle("golden ticks at rest", "proves nothing"),
    _unfit_bundle("unsigned", "is not signed, and [trust] keys are given"),
    _unfit_bundle("foreign signature", "which [trust] does not name"),
    _unfit_bundle("changed after the signature", "the bundle was changed after it was signed"),
    _process("unplug", "for good", _tripped("PORT_GONE", 1), Setup(unplug_s=9.0)),
    _process("unplug and replug", "same name, configured to go on", _BACK,
             Setup(unplug_s=1.0, replug_s=5.0)),
    _process("unplug and replug", "another name, configured to go on", _BACK,
             Setup(unplug_s=1.0, replug_s=5.0, port_renamed=True)),
    _process("together: recorder dead, disk full, SIGTERM", "at once",
             _signalled(SIGTERM), Setup(recorder_signal=SIGKILL, disk_full=True, signal=SIGTERM)),
)  # fmt: skip

PARTS: Final[dict[str, tuple[FaultRow, ...]]] = {
    "Line": LINE,
    "Servo": SERVO,
    "Host": HOST,
    "While stopping": STOPPING,
    "Feedback of the tip": FEEDBACK,
    "Goals of another program": GOALS,
    "Together": TOGETHER,
    "Processes": PROCESS,
}
"""Rows of the table by their heading in docs/safety.md."""
ROWS: Final = tuple(row for rows in PARTS.values() for row in rows)
