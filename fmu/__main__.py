"""Build, check and simulate FMUs."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from firmware_py.commands.early_interrupt import quiet_interrupt

quiet_interrupt("python -m fmu")  # before the imports that take time

from firmware_py.console import Command, dispatch  # noqa: E402

COMMANDS = (
    Command("build", "fmu.commands.build", "build a twin, predictor or observer FMU"),
    Command("ssp", "fmu.commands.ssp", "build an SSP package of twin, observer and controller"),
    Command("check", "fmu.commands.check", "validate an FMU and compare it with the Python model"),
    Command("simulate", "fmu.commands.simulate", "step an FMU in FMPy and plot the run"),
)


def main(argv: Sequence[str] | None = None) -> int:
    return dispatch("python -m fmu", __doc__ or "", COMMANDS, argv)


if __name__ == "__main__":
    sys.exit(main())
