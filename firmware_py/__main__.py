"""Run the inflatable link on the robot PC."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from firmware_py.console import Command, dispatch

COMMANDS = (
    Command("run", "firmware_py.commands.run", "drive the servos at the fixed rate"),
    Command("release", "firmware_py.commands.release", "switch the torque off"),
    Command("doctor", "firmware_py.commands.doctor", "say what would spoil the timing here"),
    Command("replay", "firmware_py.commands.replay", "replay a log through the bundle"),
    Command("bench", "firmware_py.commands.bench", "measure the tick's own cost"),
    Command("install-service", "firmware_py.commands.install_service", "write a systemd unit"),
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run `dropstitch`."""
    return dispatch("dropstitch", __doc__ or "", COMMANDS, argv)


if __name__ == "__main__":
    sys.exit(main())
