"""`python -m fmu`: alias of the commands of this room, see `dropstitch --help`."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from firmware_py.commands.early_interrupt import quiet_interrupt

quiet_interrupt("dropstitch")  # before the imports that take time

from firmware_py.commands.command_table import run_alias  # noqa: E402


def main(argv: Sequence[str] | None = None) -> int:
    return run_alias("fmu", argv)


if __name__ == "__main__":
    sys.exit(main())
