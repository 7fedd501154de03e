"""Command line of the robot PC, `dropstitch`."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from firmware_py.commands.early_interrupt import quiet_interrupt

quiet_interrupt("dropstitch")  # before the imports that take time

from firmware_py.console import Command, dispatch  # noqa: E402

COMMANDS = (
    Command("run", "firmware_py.commands.run", "run the control loop", linux_only=True),
    Command("release", "firmware_py.commands.release", "switch the torque of the servos off",
            linux_only=True),
    Command("doctor", "firmware_py.commands.doctor", "check this PC for what spoils the timing",
            linux_only=True),
    Command("replay", "firmware_py.commands.replay", "replay a log through the bundle"),
    Command("bench", "firmware_py.commands.bench", "measure the tick's own cost", linux_only=True),
    Command("install-service", "firmware_py.commands.install_service", "write a systemd service",
            linux_only=True),
)  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    """Run `dropstitch`; return its exit code, see `firmware_py.console.dispatch`."""
    return dispatch("dropstitch", __doc__ or "", COMMANDS, argv)


if __name__ == "__main__":
    sys.exit(main())
