"""What faults there are, and what must happen: the table that a campaign is judged against.

Four things hold in every case, whatever a row says (`hil.faults.fault_verdict`): no servo is driven
without hearing anything for longer than its watchdog's time, where it has one; no goal jumps; no
data passes for fresh that the servo did not send in that very tick; in the end no servo drives on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from firmware_py.bus.registers import HARDWARE_ERRORS
from hil.faults.injection import FOREVER, Injection

HOUR_S: Final = 3600.0


@dataclass(frozen=True)
class Must:
    """What must happen.

    Attributes
    ----------
    ended : str
        "finished", "tripped", "signalled", "refused" (before the torque is on), "killed", or
        "finished or tripped" where the seed decides.
    within : int or None
        Ticks in which the fault must show in the record; None where it need not.
    lost : int or None
        Ticks without fresh data, or missed, at most; None where the robot stops anyway.
    reason : str
        Words that the reason must hold; "|" parts alternatives.
    replugs : int
        Times that the robot must go on after its port was gone.
    unlogged : bool
        Whether the log must lack ticks, and nothing but the log.
    """

    ended: str
    within: int | None = None
    lost: int | None = None
    reason: str = ""
    replugs: int = 0
    unlogged: bool = False

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
        if self.replugs:
            parts.append("goes on from the measured position")
        if self.reason:
            parts.append(f"“{self.reason}”")
        return ", ".join(parts)


@dataclass(frozen=True)
class Row:
    """One fault and how it is tried.

    Attributes
    ----------
    fault, how : str
        Name of the fault; how often or how long.
    must : Must
        What must happen.
    injections : tuple of Injection
        The plan; empty where the set-up is the fault.
    lines : tuple of str
        "virtual", and "socket" where there is a timing side; "process" with real processes.
    setup : tuple of (str, float)
        What else is different: see `hil.faults.virtual_case` and `hil.faults.process_case`.
    models : tuple of int
        Model numbers to try.
    joints : int
        How many it needs at least.
    """

    fault: str
    how: str
    must: Must
    injections: tuple[Injection, ...] = ()
    lines: tuple[str, ...] = ("virtual",)
    setup: tuple[tuple[str, float], ...] = ()
    models: tuple[int, ...] = (54025, 54024)
    joints: int = 1


HARMLESS: Final = Must("finished", lost=0)
RECOVERED: Final = Must("finished", within=1, lost=0)
"""By the second read of the tick, without which the tick would be lost."""
BOTH_READS: Final = 2
"""Exchanges of a tick in which the first read fails."""
BOTH: Final = ("virtual", "socket")
LEGACY: Final = 54024
WATCHED: Final = (54025,)
"""With a bus watchdog; the legacy PRO (54024) has none."""
UNNOTICED_TICKS: Final = 90
"""A servo that refuses indirect addresses does not tell whether it drives: where it stands still it
is seen by its following error alone, late near a turning point."""
_STALE: Final = "no fresh data for 3 ticks"
_STALLED: Final = "slots missed in a row|its watchdog stopped it"


def _rides(ticks: int) -> Must:
    return Must("finished", within=1, lost=ticks)


def _tripped(reason: str, within: int) -> Must:
    return Must("tripped", within=within, reason=reason)


def _unheard(
    fault: str, kind: str, value: float = 0.0, lines: tuple[str, ...] = ("virtual",)
) -> list[Row]:
    """A fault that costs the answer: ridden out below three ticks in a row, else a controlled stop.

    The second read of a tick makes up for the first; it takes two faults to lose a tick.
    """
    once = Injection(kind, 1, value)
    one, two, three = (Injection(kind, ticks * BOTH_READS, value) for ticks in (1, 2, 3))
    return [
        Row(fault, "once", RECOVERED, (once,), lines),
        Row(fault, "both reads of a tick", _rides(1), (one,), lines),
        Row(fault, "both reads of two ticks", _rides(2), (two,)),
        Row(fault, "both reads of three ticks", _tripped(_STALE, 1), (three,)),
    ]


def _tolerated(
    fault: str, kind: str, value: float = 0.0, lines: tuple[str, ...] = ("virtual",)
) -> list[Row]:
    once, burst = Injection(kind, 1, value), Injection(kind, 10, value)
    return [
        Row(fault, "once", HARMLESS, (once,), lines),
        Row(fault, "ten in a row", HARMLESS, (burst,)),
    ]


def _persistent(fault: str, kind: str, value: float, reason: str) -> list[Row]:
    """A wild value: forgiven once, a stop at the third sample in a row."""
    return [
        Row(fault, "once", HARMLESS, (Injection(kind, 1, value),)),
        Row(fault, "three in a row", _tripped(reason, 3), (Injection(kind, 3, value),)),
    ]


def _process(fault: str, how: str, must: Must, **setup: float) -> Row:
    models = (LEGACY,) if setup.pop("legacy", 0) else WATCHED
    return Row(fault, how, must, (), ("process",), tuple(setup.items()), models)


_UNLOGGED: Final = Must("finished", lost=0, unlogged=True)
_BACK: Final = Must("finished", within=1, reason="the motion is over", replugs=1)

WIRE: Final = (
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
    Row("latency timer 16", "from the start", Must("refused", reason="latency timer"),
        lines=BOTH, setup=(("latency_s", 16e-3),)),
    Row("wrong baud", "from the start", Must("refused", reason="baud rate is the servo's"),
        setup=(("baud", 57_600),)),
    Row("return delay at its default", "from the start", HARMLESS, lines=BOTH,
        setup=(("return_delay_s", 500e-6),)),
    Row("goal whose bytes need stuffing", "−131073 pulses", HARMLESS,
        setup=(("through_pulse", -131_073),), models=WATCHED),
)  # fmt: skip

SERVO: Final = (
    Row("one servo silent", "once", RECOVERED, (Injection("silent", 1, joint=1),), joints=2),
    Row("one servo silent", "both reads of a tick", _rides(1),
        (Injection("silent", BOTH_READS, joint=1),), joints=2),
    Row("one servo silent", "for good", _tripped(_STALE, 1),
        (Injection("silent", FOREVER, joint=1),), joints=2),
    Row("both servos silent", "both reads of two ticks", _rides(2),
        (Injection("silent", 2 * BOTH_READS),), joints=2),
    Row("both servos silent", "for good", _tripped(_STALE, 1), (Injection("silent", FOREVER),),
        joints=2),
    *(
        Row("hardware error", name, _tripped(name, 1), (Injection("hardware error", 1, 1 << bit),))
        for bit, name in enumerate(HARDWARE_ERRORS)
    ),
    Row("shutdown, then started again", "without a reboot",
        Must("refused", reason="reports a hardware error (overload)"),
        setup=(("hardware_error", 1 << 5),)),
    Row("shutdown, then started again", "after a reboot", HARMLESS,
        setup=(("hardware_error", 1 << 5), ("reboot", 1))),
    Row("reboot in motion", "once", _tripped("its torque went off", 1), (Injection("reboot"),)),
    Row("reboot in motion", "once, of servos that refuse indirect addresses",
        _tripped("away from its goal", UNNOTICED_TICKS), (Injection("reboot"),),
        setup=(("direct", 1),)),
    Row("torque lost", "once", _tripped("its torque went off", 1), (Injection("torque"),)),
    Row("watchdog trip", "once", _tripped("its watchdog stopped it", 1),
        (Injection("watchdog"),), models=WATCHED),
    Row("arm leans at the start", "by 20°", HARMLESS, setup=(("lean_rad", 0.349),)),
    Row("arm leans at the start", "by −34°, just inside limits.angle_rad", HARMLESS,
        setup=(("lean_rad", -0.595),)),
    Row("arm leans at the start", "by 35°, outside", Must("refused", reason="move it by hand"),
        setup=(("lean_rad", 0.611),)),
    Row("wrong model number", "all servos", Must("refused", reason="not"), setup=(("found", 1),)),
    Row("legacy and new PRO on one bus", "declared", Must("refused", reason="different control"),
        setup=(("mixed", 1),), joints=2),
    Row("legacy and new PRO on one bus", "undeclared", Must("refused", reason="servo 2 is"),
        setup=(("mixed", 2),), joints=2),
    *_persistent("encoder jump of 0.3 rad", "encoder", 0.3, "away from its goal"),
    *_persistent("current spike of 12 A", "current", 12.0, "draws"),
)  # fmt: skip

HOST: Final = (
    *_persistent("NaN out of the predictor", "predictor", math.nan, "predicted tip"),
    *_persistent("infinity out of the predictor", "predictor", math.inf, "predicted tip"),
    *_persistent("NaN out of the estimator", "estimator", math.nan, "Deformation Index"),
    *_persistent("infinity out of the estimator", "estimator", math.inf, "Deformation Index"),
    Row("predictor taking 30 ms", "once", Must("finished", within=2, lost=2),
        (Injection("slow predictor", 1, 30e-3),), BOTH),
    Row("predictor taking 30 ms", "for good", _tripped("too slow for its period", 2),
        (Injection("slow predictor", FOREVER, 30e-3),), BOTH),
    Row("host stall of 5 ms", "once", HARMLESS, (Injection("stall", 1, 5e-3),), BOTH),
    Row("host stall of 20 ms", "once", Must("finished", within=2, lost=2),
        (Injection("stall", 1, 20e-3),), BOTH),
    Row("host stall of 100 ms", "once", _tripped(_STALLED, 2),
        (Injection("stall", 1, 100e-3),), BOTH),
    Row("garbage-collector pressure", "for good", HARMLESS, (Injection("garbage", FOREVER),),
        ("socket",), models=WATCHED),
    Row("clock stepped by +1 h", "once", _tripped("slots missed in a row", 2),
        (Injection("clock", FOREVER, HOUR_S),)),
    Row("clock stepped by −1 h", "once", _tripped("the clock was set back", 2),
        (Injection("clock", FOREVER, -HOUR_S),)),
    Row("unplug", "for good", _tripped("no fresh data for 3 ticks (PORT_GONE)", 1),
        (Injection("port", FOREVER, math.inf),)),
    Row("unplug and replug", "configured to stay stopped",
        _tripped("no fresh data for 3 ticks (PORT_GONE)", 1), (Injection("port", FOREVER, 1.2),)),
    Row("unplug and replug", "configured to go on",
        _BACK,
        (Injection("port", FOREVER, 1.2),), setup=(("replug_s", 5.0),)),
)  # fmt: skip

TOGETHER: Final = (
    Row("together: lost, flipped, truncated, noise", "one after the other", RECOVERED,
        (Injection("lost"), Injection("flip in payload", after=3), Injection("truncated", after=6),
         Injection("noise", after=8), Injection("flip in length", after=9)), BOTH),
    Row("together: late by a period and encoder jump", "both reads of two ticks, then once",
        _rides(2),
        (Injection("late", 2 * BOTH_READS, 17e-3),
         Injection("encoder", 1, 0.3, after=2 * BOTH_READS))),
    Row("together: lost reply in a stall of 20 ms", "once", _rides(2),
        (Injection("lost"), Injection("stall", 1, 20e-3))),
    Row("together: lost replies in a stall of 20 ms", "both reads of a tick", _rides(3),
        (Injection("lost", BOTH_READS), Injection("stall", 1, 20e-3))),
    Row("together: lost replies in a stall of 60 ms", "both reads of two ticks",
        _tripped("no fresh data|missed", 2),
        (Injection("lost", 2 * BOTH_READS), Injection("stall", 1, 60e-3))),
    Row("together: one silent, the other overheats", "for good",
        _tripped(f"{_STALE}|overheating", 1),
        (Injection("silent", FOREVER, joint=1), Injection("hardware error", 1, 4, joint=0)),
        joints=2),
    Row("together: NaN out of the predictor, then lost", "two and one",
        HARMLESS, (Injection("predictor", 2, math.nan), Injection("lost", after=2))),
    Row("together: unplugged during a bad stretch", "configured to go on",
        _BACK,
        (Injection("flip in payload", 2 * BOTH_READS), Injection("port", FOREVER, 1.0, after=2)),
        setup=(("replug_s", 5.0),)),
    Row("together: 5 % each of six faults of the wire", "all along", Must("finished or tripped"),
        tuple(Injection(kind, 1, 17e-3, after=after) for after, kind in enumerate(
            ("lost", "late", "duplicated", "flip in payload", "truncated", "noise") * 4))),
)  # fmt: skip

PROCESS: Final = (
    _process("SIGTERM in motion", "once", Must("signalled", reason="SIGTERM"), signal=15),
    _process("SIGKILL in motion", "once", Must("killed"), signal=9),
    _process("SIGKILL in motion", "once, legacy PRO", Must("killed"), signal=9, legacy=1),
    _process("host stall of 5 ms", "process stopped", Must("finished", lost=1), freeze_s=5e-3),
    _process("host stall of 20 ms", "process stopped", Must("finished", lost=3), freeze_s=20e-3),
    _process("host stall of 100 ms", "process stopped", _tripped(_STALLED, 2), freeze_s=0.1),
    _process("recorder dead", "killed", _UNLOGGED, recorder=9),
    _process("recorder blocked", "stopped for good", _UNLOGGED, recorder=19),
    _process("full disk", "no byte more from now on", _UNLOGGED, disk=1),
    _process("bundle swapped on disk", "every file", HARMLESS, swap=1),
    _process("unplug", "for good", _tripped("PORT_GONE", 1), unplug_s=9.0),
    _process("unplug and replug", "same name, configured to go on", _BACK,
             unplug_s=1.0, replug_s=5.0),
    _process("unplug and replug", "another name, configured to go on", _BACK,
             unplug_s=1.0, replug_s=5.0, rename=1),
    _process("together: recorder dead, disk full, SIGTERM", "at once",
             Must("signalled", reason="SIGTERM"), recorder=9, disk=1, signal=15),
)  # fmt: skip

ROWS: Final = (*WIRE, *SERVO, *HOST, *TOGETHER, *PROCESS)
