"""Run the loop against emulated servos, inject faults, and report on the results."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from firmware_py.commands.early_interrupt import quiet_interrupt

quiet_interrupt("python -m hil")  # before the imports that take time

from firmware_py.console import Command, dispatch  # noqa: E402

COMMANDS = (
    Command("emulate", "hil.commands.emulate", "emulate servos for any Dynamixel program",
            linux_only=True),
    Command("sil", "hil.commands.sil", "run the loop in software, judge its timing",
            linux_only=True),
    Command("faults", "hil.commands.faults", "inject every fault, check what happens",
            linux_only=True),
    Command("campaign", "hil.commands.campaign", "run many cases, here or on a cluster",
            linux_only=True),
    Command("gap", "hil.commands.gap", "write the HTML report of a diagnosed gap"),
    Command("plans", "hil.commands.plans", "write the HTML page of plans that were run on the rig"),
    Command("report", "hil.commands.report", "write the HTML report of a whole run"),
)  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    return dispatch("python -m hil", __doc__ or "", COMMANDS, argv)


if __name__ == "__main__":
    sys.exit(main())
