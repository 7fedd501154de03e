"""Fault table: each fault, how it is injected, the outcome that it must have, what this proves.

Some conditions hold in every case (`hil.faults.faults_document`):

- No servo with a watchdog is driven without an instruction for longer than the watchdog's timeout.
- No goal jumps.
- No data counts as fresh unless the servo sent it in the same tick.
- At the end no servo is driven.
- The torque of a robot that was refused was never on.

How to add a row: docs/guides/extend.md.
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
from hil.faults.fault_row import USUAL, Expectation, FaultRow, Injection, Setup

Proves = tuple[str, ...]
FOREVER: Final = 1_000_000
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
_GOES_ON: Final = Expectation(  # the motion continues to its end, but a fault denies the success
    "tripped", within=1, reason="then the port was back; then the motion is over", replugs=1
)
_REPLUGGED: Final = ("SR-04", "SR-08", "SR-10", "SR-14")


def _rides(ticks: int, within: int = 1) -> Expectation:
    return Expectation("finished", within=within, lost=ticks)


def _tripped(reason: str, within: int) -> Expectation:
    return Expectation("tripped", within=within, reason=reason)


def _refused(reason: str) -> Expectation:
    return Expectation("refused", reason=reason)


# --- line

_FLOODED: Final = Expectation("tripped", within=1, reason=_STALE, on_time=True)


def _unheard(
    fault: str, proves: Proves, kind: str, value: float = 0.0,
    lines: tuple[str, ...] = ("virtual",),
) -> list[FaultRow]:  # fmt: skip
    """Fault that loses the reply: up to two ticks in a row are tolerated, three bring a stop.

    A failed read is retried once in the same tick, so only two faults lose a tick.
    """
    once = Injection(kind, 1, value)
    one, two, three = (Injection(kind, ticks * BOTH_READS, value) for ticks in (1, 2, 3))
    return [
        FaultRow(fault, "once", RECOVERED, (once,), lines, proves=proves),
        FaultRow(fault, "both reads of a tick", _rides(1), (one,), lines, proves=proves),
        FaultRow(fault, "both reads of two ticks", _rides(2), (two,), proves=proves),
        FaultRow(fault, "both reads of three ticks", _tripped(_STALE, 1), (three,), proves=proves),
    ]


def _tolerated(
    fault: str, proves: Proves, kind: str, value: float = 0.0,
    lines: tuple[str, ...] = ("virtual",),
) -> list[FaultRow]:  # fmt: skip
    once, burst = Injection(kind, 1, value), Injection(kind, 10, value)
    return [
        FaultRow(fault, "once", HARMLESS, (once,), lines, proves=proves),
        FaultRow(fault, "ten in a row", HARMLESS, (burst,), proves=proves),
    ]


LINE: Final = (
    *_unheard("lost reply", ("SR-06", "SR-15", "SR-16"), "lost", lines=BOTH),
    *_tolerated("reply late by 1 ms", ("SR-15",), "late", 1e-3, BOTH),
    *_tolerated("reply late by 5 ms", ("SR-15",), "late", 5e-3, BOTH),
    *_unheard("reply late by a period", ("SR-18",), "late", 17e-3, BOTH),
    *_unheard("reply late by 20 ms", ("SR-18",), "late", 20e-3, BOTH),
    *_tolerated("duplicated reply", ("SR-18",), "duplicated"),
    *_unheard("bit flip in header", ("SR-20",), "flip in header"),
    *_unheard("bit flip in length", ("SR-20",), "flip in length"),
    *_unheard("bit flip in payload", ("SR-20",), "flip in payload"),
    *_unheard("bit flip in CRC", ("SR-20",), "flip in CRC"),
    *_unheard("truncation", ("SR-20",), "truncated"),
    *_tolerated("noise before a packet", ("SR-20",), "noise"),
    *_unheard("reply from another id", ("SR-20",), "other id"),
    FaultRow("babbling line", "4 kB before each reply", _FLOODED,
        (Injection("babble", FOREVER, 4e-3),), BOTH, proves=("SR-17",)),
    FaultRow("flood of bytes", "at the rate of the fastest line, 4 Mbaud", _FLOODED,
        (Injection("flood", FOREVER, 0.4e6),), proves=("SR-17",)),
    FaultRow("flood of bytes", "without a pause, as from another process", _FLOODED,
        (Injection("flood", FOREVER, 1e9),), proves=("SR-17",)),
    FaultRow("latency timer 16", "from the start", _refused("latency timer"), lines=BOTH,
        setup=Setup(latency_s=16e-3), proves=("SR-02",)),
    FaultRow("wrong baud", "from the start", _refused("baud rate is the servo's"),
        setup=Setup(wrong_baud=True), proves=("SR-02",)),
    FaultRow("return delay at its default", "from the start", HARMLESS, lines=BOTH,
        proves=("SR-17",)),
    FaultRow("goal whose bytes need stuffing", "−131073 pulses", HARMLESS,
        setup=Setup(through_pulse=-131_073), models=WATCHED, proves=("SR-20", "SR-22")),
)  # fmt: skip

# --- servo


def _changed(
    how: str, register: Register, raw: int, reason: str, models: tuple[int, ...] = ALL_MODELS
) -> FaultRow:
    """Servo with a setting other than the plant assumes."""
    return FaultRow(
        "changed servo setting", how, _refused(reason), setup=Setup(setting=(register, raw)),
        models=models, proves=("SR-03",),
    )  # fmt: skip


def _persistent(fault: str, kind: str, value: float, reason: str) -> list[FaultRow]:
    """Outlier: tolerated once, a controlled stop at the third sample in a row."""
    once, three = Injection(kind, 1, value), Injection(kind, 3, value)
    return [
        FaultRow(fault, "once", HARMLESS, (once,), proves=("SR-21",)),
        FaultRow(fault, "three in a row", _tripped(reason, 3), (three,), proves=("SR-21",)),
    ]


SERVO: Final = (
    FaultRow("one servo silent", "once", RECOVERED, (Injection("silent", 1, joint=1),), joints=2,
        proves=("SR-15",)),
    FaultRow("one servo silent", "both reads of a tick", _rides(1),
        (Injection("silent", BOTH_READS, joint=1),), joints=2, proves=("SR-15", "SR-16")),
    FaultRow("one servo silent", "for good", _tripped(_STALE, 1),
        (Injection("silent", FOREVER, joint=1),), joints=2, proves=("SR-16",)),
    FaultRow("both servos silent", "both reads of two ticks", _rides(2),
        (Injection("silent", 2 * BOTH_READS),), joints=2, proves=("SR-16",)),
    FaultRow("both servos silent", "for good", _tripped(_STALE, 1), (Injection("silent", FOREVER),),
        joints=2, proves=("SR-16",)),
    *(
        FaultRow("hardware error", name, _tripped(name, 1),
            (Injection("hardware error", 1, 1 << bit),), proves=("SR-23",))
        for bit, name in enumerate(HARDWARE_ERRORS)
    ),
    FaultRow("shutdown, then started again", "without a reboot",
        _refused("reports a hardware error (overload)"),
        setup=Setup(hardware_error=1 << 5), proves=("SR-02",)),
    FaultRow("shutdown, then started again", "after a reboot", HARMLESS,
        setup=Setup(hardware_error=1 << 5, rebooted=True), proves=("SR-02",)),
    FaultRow("reboot in motion", "once", _tripped("its torque went off", 1),
        (Injection("reboot"),), proves=("SR-19",)),
    FaultRow("reboot in motion", "once, of servos that refuse indirect addresses",
        _tripped("repeats angle and current|away from its goal", UNNOTICED_TICKS),
        (Injection("reboot"),), setup=Setup(refuses_indirect=True), proves=("SR-19",)),
    FaultRow("torque lost", "once", _tripped("its torque went off", 1), (Injection("torque"),),
        proves=("SR-19",)),
    FaultRow("watchdog trip", "once", _tripped("its watchdog stopped it", 1),
        (Injection("watchdog"),), models=WATCHED, proves=("SR-19",)),
    FaultRow("arm leans at the start", "by 20°", HARMLESS, setup=Setup(lean_rad=0.349),
        proves=("SR-05",)),
    FaultRow("arm leans at the start", "by −34°, just inside limits.angle_rad", HARMLESS,
        setup=Setup(lean_rad=-0.595), proves=("SR-05",)),
    FaultRow("arm leans at the start", "by 35°, outside", _refused("move it by hand"),
        setup=Setup(lean_rad=0.611), proves=("SR-05",)),
    FaultRow("wrong model number", "all servos", _refused("not"), setup=Setup(wrong_model=True),
        proves=("SR-02",)),
    FaultRow("legacy and new PRO on one bus", "declared", _refused("different control"),
        setup=Setup(second_model="declared"), joints=2, proves=("SR-02",)),
    FaultRow("legacy and new PRO on one bus", "undeclared", _refused("servo 2 is"),
        setup=Setup(second_model="undeclared"), joints=2, proves=("SR-02",)),
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
        setup=Setup(setting=(Register.PROFILE_ACCELERATION, 10)), proves=("SR-03",)),
    *_persistent("encoder jump of 0.3 rad", "encoder", 0.3, "away from its goal"),
    *_persistent("current spike of 12 A", "current", 12.0, "draws"),
    FaultRow("frozen feedback", "for five samples", HARMLESS, (Injection("frozen", 5),),
        proves=("SR-30",)),
    FaultRow("frozen feedback", "for good", _tripped("repeats angle and current", FROZEN_TICKS),
        (Injection("frozen", FOREVER),), proves=("SR-30",)),
    FaultRow("frozen feedback", "for good, of one servo",
        _tripped("joint 2 repeats angle and current", FROZEN_TICKS),
        (Injection("frozen", FOREVER, joint=1),), joints=2, proves=("SR-30",)),
)  # fmt: skip

# --- host

HOST: Final = (
    *_persistent("NaN out of the predictor", "predictor", math.nan, "predicted tip"),
    *_persistent("infinity out of the predictor", "predictor", math.inf, "predicted tip"),
    *_persistent("NaN out of the estimator", "estimator", math.nan, "Deformation Index"),
    *_persistent("infinity out of the estimator", "estimator", math.inf, "Deformation Index"),
    FaultRow("predictor taking 30 ms", "once", _rides(2, within=2),
        (Injection("slow predictor", 1, 30e-3),), BOTH, proves=("SR-24",)),
    FaultRow("predictor taking 30 ms", "for good", _tripped("too slow for its period", 2),
        (Injection("slow predictor", FOREVER, 30e-3),), BOTH, proves=("SR-24",)),
    FaultRow("host stall of 5 ms", "once", HARMLESS, (Injection("stall", 1, 5e-3),), BOTH,
        proves=("SR-24",)),
    FaultRow("host stall of 20 ms", "once", _rides(2, within=2), (Injection("stall", 1, 20e-3),),
        BOTH, proves=("SR-04", "SR-24")),
    FaultRow("host stall of 100 ms", "once", _tripped(_STALLED, 2),
        (Injection("stall", 1, 100e-3),), BOTH, proves=("SR-24",)),
    FaultRow("garbage-collector pressure", "for good", HARMLESS, (Injection("garbage", FOREVER),),
        ("socket",), models=WATCHED, proves=("SR-24",)),
    FaultRow("clock stepped by +1 h", "once", _tripped("slots missed in a row", 2),
        (Injection("clock", FOREVER, HOUR_S),), proves=("SR-04", "SR-24")),
    FaultRow("clock stepped by −1 h", "once", _tripped("the clock was set back", 2),
        (Injection("clock", FOREVER, -HOUR_S),), proves=("SR-24",)),
    FaultRow("unplug", "for good", _tripped("no fresh data for 3 ticks (PORT_GONE)", 1),
        (Injection("port", FOREVER, math.inf),), proves=("SR-14",)),
    FaultRow("unplug and replug", "configured to stay stopped",
        _tripped("no fresh data for 3 ticks (PORT_GONE)", 1), (Injection("port", FOREVER, 1.2),),
        proves=("SR-10", "SR-14")),
    FaultRow("unplug and replug", "configured to go on", _GOES_ON,
        (Injection("port", FOREVER, 1.2),), setup=Setup(replug_s=5.0),
        proves=_REPLUGGED),
)  # fmt: skip

# --- while the robot stops


def _while_stopping(
    fault: str, how: str, proves: Proves, reason: str, *injections: Injection, joints: int = 1
) -> FaultRow:
    """Faults that begin five ticks after the request of a controlled stop.

    The emulated line has no faults while no servo is driven. So with one servo, the retry of torque
    off is always confirmed.
    """
    later = (replace(injection, after=5) for injection in injections)
    return FaultRow(
        fault, how, _tripped(f"a request; then {reason}", 1), (Injection("request"), *later),
        joints=joints, proves=proves,
    )  # fmt: skip


STOPPING: Final = (
    _while_stopping("overload while stopping", "once", ("SR-08", "SR-09"),
        "a servo raises an alert (overload", Injection("hardware error", 1, 1 << 5)),
    _while_stopping("torque lost while stopping", "once", ("SR-08", "SR-09"),
        "a servo raises an alert (its torque went off)", Injection("torque")),
    _while_stopping("current of 12 A while stopping", "for good", ("SR-08", "SR-09"),
        "joint 1 draws", Injection("current", FOREVER, 12.0)),
    _while_stopping("lost replies while stopping", "for good", ("SR-08", "SR-16"),
        f"{_STALE} (TIMEOUT); then {UNRELEASED}", Injection("lost", FOREVER), joints=2),
    _while_stopping("torque off unheard, late replies", "the first to each servo", ("SR-08",),
        _STALE, Injection("late", FOREVER, 12e-3), Injection(UNHEARD, 1)),
    _while_stopping("unplug while stopping", "for good", ("SR-08", "SR-09"),
        f"{_STALE} (PORT_GONE); then {UNRELEASED}", Injection("port", FOREVER, math.inf)),
)  # fmt: skip

# --- feedback of the estimated tip: every way in which trust is lost

_FEEDBACK: Final = Setup(feedback="continue")
_OR_STOP: Final = Setup(feedback="stop")
_NO_TRUST: Final = "the estimated tip is no longer trusted"
_NO_LONGER_CORRECTED: Final = Expectation("finished", lost=0, trust="LOST")


def _doubted(fault: str, kind: str, value: float, reason: str) -> list[FaultRow]:
    """Fault of the estimated tip: one tick is ignored; if it lasts, corrections fade, or a stop."""
    once, many = Injection(kind, 1, value), Injection(kind, 30, value)
    stopped = Expectation("tripped", within=2, reason=f"{_NO_TRUST}: {reason}", trust="LOST")
    return [
        FaultRow(fault, "once", Expectation("finished", lost=0, trust="TRUSTED"), (once,),
            setup=_FEEDBACK, proves=("SR-28",)),
        FaultRow(fault, "30 ticks, configured to go on", _NO_LONGER_CORRECTED, (many,),
            setup=_FEEDBACK, proves=("SR-28",)),
        FaultRow(fault, "30 ticks, configured to stop", stopped, (many,), setup=_OR_STOP,
            proves=("SR-28",)),
    ]  # fmt: skip


FEEDBACK: Final = (
    *_doubted("innovation of the current too large", "innovation", 2.0, "its innovation is 2.00 A"),
    *_doubted("estimated tip out of range", "range", 0.0, "it is out of range"),
    FaultRow("estimated tip not finite", "two ticks, configured to go on", _NO_LONGER_CORRECTED,
        (Injection("predictor", 2, math.nan),), setup=_FEEDBACK, proves=("SR-28",)),
    FaultRow("stale data under feedback", "two ticks, configured to go on",
        Expectation("finished", within=1, lost=2, trust="LOST"),
        (Injection("lost", 2 * BOTH_READS),), setup=_FEEDBACK, proves=("SR-28",)),
    FaultRow("stale data under feedback", "two ticks, configured to stop",
        Expectation("tripped", within=1, reason=f"{_NO_TRUST}: the data is stale", trust="LOST"),
        (Injection("lost", 2 * BOTH_READS),), setup=_OR_STOP, proves=("SR-28",)),
    FaultRow("host stall of 20 ms under feedback", "once",
        Expectation("finished", within=2, lost=2, trust="TRUSTED"),
        (Injection("stall", 1, 20e-3),), setup=_FEEDBACK, proves=("SR-24", "SR-28")),
)  # fmt: skip

# --- goals of another program


def _program(how: str, kind: str, must: Expectation, times: int = FOREVER) -> FaultRow:
    return FaultRow(
        "program that sends the goals", how, must, (Injection(kind, times),), proves=("SR-29",)
    )


def _rejected(reason: str, within: int = 2) -> Expectation:
    return Expectation("tripped", within=within, lost=0, reason=f"sends the goals {reason}")


GOALS: Final = (
    _program("silent for two ticks", "program silent", HARMLESS, 2),
    _program("silent for good", "program silent", _rejected("has sent none for 3 ticks", 4)),
    _program("stuck: it repeats an old answer", "program stuck",
        _rejected("sends goals that are", 6)),
    _program("malformed message", "program malformed", _rejected("sends a message that cannot"), 1),
    _program("too fast: a step of 0.2 rad", "program too fast", _rejected("moves joint 1 at"), 1),
    _program("tip out of reach", "program out of reach", _rejected("wants the tip at"), 1),
    _program("eight messages in a tick", "program flooding",
        _rejected("sends more than 4 goals"), 1),
    _program("program dies", "program gone", _rejected("has gone")),
)  # fmt: skip

# --- several faults together

TOGETHER: Final = (
    FaultRow("together: lost, flipped, truncated, noise", "one after the other", RECOVERED,
        (Injection("lost"), Injection("flip in payload", after=3), Injection("truncated", after=6),
         Injection("noise", after=8), Injection("flip in length", after=9)), BOTH,
        proves=("SR-15", "SR-20")),
    FaultRow("together: late by a period and encoder jump", "both reads of two ticks, then once",
        _rides(2),
        (Injection("late", 2 * BOTH_READS, 17e-3),
         Injection("encoder", 1, 0.3, after=2 * BOTH_READS)), proves=("SR-16", "SR-21")),
    FaultRow("together: lost reply in a stall of 20 ms", "once", _rides(2),
        (Injection("lost"), Injection("stall", 1, 20e-3)), proves=("SR-16", "SR-24")),
    FaultRow("together: lost replies in a stall of 20 ms", "both reads of a tick", _rides(3),
        (Injection("lost", BOTH_READS), Injection("stall", 1, 20e-3)), proves=("SR-16", "SR-24")),
    FaultRow("together: lost replies in a stall of 60 ms", "both reads of two ticks",
        _tripped("no fresh data|missed", 2),
        (Injection("lost", 2 * BOTH_READS), Injection("stall", 1, 60e-3)),
        proves=("SR-16", "SR-24")),
    FaultRow("together: one silent, the other overheats", "for good",
        _tripped(f"{_STALE}|overheating", 1),
        (Injection("silent", FOREVER, joint=1), Injection("hardware error", 1, 4, joint=0)),
        joints=2, proves=("SR-16", "SR-23")),
    FaultRow("together: NaN out of the predictor, then lost", "two and one", HARMLESS,
        (Injection("predictor", 2, math.nan), Injection("lost", after=2)),
        proves=("SR-15", "SR-21")),
    FaultRow("together: unplugged during a bad stretch", "configured to go on", _GOES_ON,
        (Injection("flip in payload", 2 * BOTH_READS), Injection("port", FOREVER, 1.0, after=2)),
        setup=Setup(replug_s=5.0), proves=("SR-14", "SR-16")),
    FaultRow("together: 5 % each of six faults of the line", "all along",
        Expectation("finished or tripped"),
        tuple(Injection(kind, 1, 17e-3, after=after) for after, kind in enumerate(
            ("lost", "late", "duplicated", "flip in payload", "truncated", "noise") * 4)),
        proves=("SR-06", "SR-16")),
)  # fmt: skip

# --- real processes


def _process(
    fault: str, how: str, proves: Proves, must: Expectation, *injections: Injection,
    setup: Setup = USUAL, models: tuple[int, ...] = WATCHED,
) -> FaultRow:  # fmt: skip
    return FaultRow(fault, how, must, injections, ("process",), setup, models, proves=proves)


def _signalled(
    number: Signals, how: str, proves: Proves, models: tuple[int, ...] = WATCHED
) -> FaultRow:
    """Signal to the robot, which only SIGKILL ends at once."""
    must = Expectation("killed")
    if number != SIGKILL:
        must = Expectation("signalled", reason=number.name)
    fault = f"{number.name} in motion"
    return _process(fault, how, proves, must, Injection("signal", value=number), models=models)


def _unfit_bundle(damage: str, reason: str) -> FaultRow:
    """Bundle that is refused before any of its code runs."""
    return _process("unfit bundle", damage, ("SR-26",), _refused(reason), Injection(damage))


_UNLOGGED: Final = Expectation("finished", lost=0, unlogged=True)

PROCESS: Final = (
    *(
        _signalled(number, "once", ("SR-07",))
        for number in (SIGTERM, SIGHUP, SIGQUIT, SIGUSR1, SIGUSR2, SIGPIPE, SIGTSTP)
    ),
    _signalled(SIGHUP, "once, legacy PRO", ("SR-07", "SR-13"), (LEGACY,)),
    _signalled(SIGKILL, "once", ("SR-11", "SR-12")),
    _signalled(SIGKILL, "once, legacy PRO", ("SR-12", "SR-13"), (LEGACY,)),
    _process("host stall of 5 ms", "process stopped", ("SR-24",), Expectation("finished", lost=1),
        Injection("freeze", value=5e-3)),
    _process("host stall of 20 ms", "process stopped", ("SR-04", "SR-24"),
        Expectation("finished", lost=3), Injection("freeze", value=20e-3)),
    _process("host stall of 100 ms", "process stopped", ("SR-24",), _tripped(_STALLED, 2),
        Injection("freeze", value=0.1)),
    _process("recorder dead", "killed", ("SR-25",), _UNLOGGED,
        Injection("recorder signal", value=SIGKILL)),
    _process("recorder blocked", "stopped for good", ("SR-25",), HARMLESS,
        Injection("recorder signal", value=SIGSTOP)),
    _process("full disk", "no byte more from now on", ("SR-25",), _UNLOGGED,
        Injection("disk full")),
    _process("bundle swapped on disk", "every file", ("SR-25",), HARMLESS,
        Injection("bundle swapped")),
    _unfit_bundle("changed file", "predictor.onnx: does not match the hash"),
    _unfit_bundle("unnamed file", "names no predictor.onnx"),
    _unfit_bundle("file outside", "is no file of a bundle"),
    _unfit_bundle("other golden ticks", "the bundle expects"),
    _unfit_bundle("golden ticks at rest", "proves nothing"),
    _unfit_bundle("unsigned", "is not signed, and [trust] keys are given"),
    _unfit_bundle("foreign signature", "which [trust] does not name"),
    _unfit_bundle("changed after the signature", "the bundle was changed after it was signed"),
    _process("unplug", "for good", ("SR-14",), _tripped("PORT_GONE", 1), Injection("unplug")),
    _process("unplug and replug", "same name, configured to go on", _REPLUGGED,
        _GOES_ON, Injection("unplug", value=1.0), setup=Setup(replug_s=5.0)),
    _process("unplug and replug", "another name, configured to go on", _REPLUGGED,
        _GOES_ON, Injection("unplug", value=1.0), setup=Setup(replug_s=5.0, port_renamed=True)),
    _process("together: recorder dead, disk full, SIGTERM", "at once", ("SR-07", "SR-25"),
        Expectation("signalled", reason="SIGTERM"), Injection("disk full"),
        Injection("recorder signal", value=SIGKILL), Injection("signal", value=SIGTERM)),
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
"""Rows of the table by their heading in docs/safety/faults.md."""
ROWS: Final = tuple(row for rows in PARTS.values() for row in rows)
