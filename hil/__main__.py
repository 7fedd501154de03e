"""The loop against an emulated servo: emulate, sil, faults, gap, report."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from firmware_py.console import Command, dispatch

COMMANDS = (
    Command("emulate", "hil.commands.emulate", "be a servo for any Dynamixel program"),
    Command("sil", "hil.commands.sil", "run the loop in software, judge its timing"),
    Command("faults", "hil.commands.faults", "inject every fault, judge what happens"),
    Command("gap", "hil.commands.gap", "write the HTML report of a gap found and closed"),
    Command("report", "hil.commands.report", "write the HTML report of a whole run"),
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run `python -m hil`."""
    return dispatch("python -m hil", __doc__ or "", COMMANDS, argv)


if __name__ == "__main__":
    sys.exit(main())
