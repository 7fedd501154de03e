"""Interrupt before a command runs: Ctrl-C during the imports of a program shows no traceback.

A program calls `quiet_interrupt` before its other imports, which take 0.2 s. So this module imports
almost nothing.
"""

import sys
from types import TracebackType


def quiet_interrupt(prog: str) -> None:
    """Report an unhandled Ctrl-C in one sentence instead of a traceback."""
    before = sys.excepthook

    def report(
        kind: type[BaseException], error: BaseException, trace: TracebackType | None
    ) -> None:  # fmt: skip
        if issubclass(kind, KeyboardInterrupt):
            print(f"{prog}: interrupted", file=sys.stderr)
        else:
            before(kind, error, trace)

    sys.excepthook = report
