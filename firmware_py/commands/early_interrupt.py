"""Interruption before a command runs: Ctrl-C during the imports of a program gives no traceback.

A program calls it before its other imports, which take 0.2 s; so this module imports next to none.
"""

import sys
from types import TracebackType

__all__ = ["quiet_interrupt"]


def quiet_interrupt(prog: str) -> None:
    """Say in one sentence that a program was interrupted where nothing else handles it."""
    before = sys.excepthook

    def said(
        kind: type[BaseException], error: BaseException, trace: TracebackType | None
    ) -> None:  # fmt: skip
        if issubclass(kind, KeyboardInterrupt):
            print(f"{prog}: interrupted", file=sys.stderr)
        else:
            before(kind, error, trace)

    sys.excepthook = said
