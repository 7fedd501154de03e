"""The command `dropstitch`; `python -m dropstitch` is the same."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from firmware_py.commands.early_interrupt import quiet_interrupt

quiet_interrupt("dropstitch")  # before the imports that take time

from firmware_py.commands.command_table import COMMANDS, DESCRIPTION, PROG  # noqa: E402
from firmware_py.core.console import dispatch  # noqa: E402


def main(argv: Sequence[str] | None = None) -> int:
    """Run `dropstitch`; return its exit code, see `firmware_py.core.console.dispatch`."""
    return dispatch(PROG, DESCRIPTION, COMMANDS, argv)


if __name__ == "__main__":
    sys.exit(main())
