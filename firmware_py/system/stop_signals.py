"""Signals that end or halt a process by default, turned into requests for a controlled stop.

A closed terminal or a lost ssh session sends SIGHUP, Ctrl-C SIGINT, Ctrl-Z SIGTSTP; unhandled,
each leaves the torque on. Not handled are:

- SIGKILL and SIGSTOP, which no program can handle;
- the signals of a crash (SIGSEGV, SIGABRT and the like), after which no program can continue;
- signals without effect by default (SIGCHLD, SIGCONT, SIGURG, SIGWINCH).
"""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Final

_UNHANDLED: Final = frozenset({
    "SIGKILL", "SIGSTOP",
    "SIGSEGV", "SIGBUS", "SIGFPE", "SIGILL", "SIGABRT", "SIGTRAP", "SIGSYS",
    "SIGCHLD", "SIGCONT", "SIGURG", "SIGWINCH",
})  # fmt: skip
"""By name, because Windows has few of them but imports the loop for planning."""
STOP_SIGNALS: Final = tuple(
    sorted(int(s) for s in signal.valid_signals() if getattr(s, "name", "") not in _UNHANDLED)
)
"""Numbers of the signals that request a controlled stop, real-time signals included."""


@contextlib.contextmanager
def signals_to(stop: Callable[[str], None]) -> Iterator[None]:
    """Turn `STOP_SIGNALS` into requests for a controlled stop (main thread only).

    If SIGHUP is ignored at the start, as under `nohup`, it stays ignored.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def handler(number: int, frame: FrameType | None) -> None:
        stop(_name(number))

    before = {
        number: signal.signal(number, handler)
        for number in STOP_SIGNALS
        if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN
    }
    try:
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)


def _name(number: int) -> str:
    """Return the name of a signal, also of real-time signals without one in Python."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"SIGRTMIN+{number - signal.SIGRTMIN}"
