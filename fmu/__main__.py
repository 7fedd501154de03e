"""FMI units: build, check and simulate."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from firmware_py.console import Command, dispatch

COMMANDS = (
    Command("build", "fmu.commands.build", "build a twin, predictor or observer unit"),
    Command("check", "fmu.commands.check", "validate a unit and its parity with Python"),
    Command("simulate", "fmu.commands.simulate", "step a unit in FMPy and plot it"),
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run `python -m fmu`."""
    return dispatch("python -m fmu", __doc__ or "", COMMANDS, argv)


if __name__ == "__main__":
    sys.exit(main())
