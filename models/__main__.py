"""Offline commands: from trials to plant and bundle."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from firmware_py.commands.early_interrupt import quiet_interrupt

quiet_interrupt("python -m models")  # before the imports that take time

from firmware_py.console import Command, dispatch  # noqa: E402

GAP_WORKFLOW = "models.commands.gap_workflow"

COMMANDS = (
    Command("new", "models.commands.new", "describe a link of your own"),
    Command("simulate", "models.commands.simulate", "run the rig, write trials"),
    Command("import", "models.commands.import_", "turn mocap and servo logs into trials"),
    Command("validate", "models.commands.validate", "check trials before a fit"),
    Command("identify", "models.commands.identify", "fit the plant to trials"),
    Command("evaluate", "models.commands.evaluate", "compare a plant with trials"),
    Command(
        "calibrate",
        f"{GAP_WORKFLOW}.calibrate",
        "measure the plant's own error for gap",
    ),
    Command("gap", f"{GAP_WORKFLOW}.gap", "find the effect that the plant lacks, add it"),
    Command(
        "experiment",
        f"{GAP_WORKFLOW}.experiment",
        "design the motion that separates best",
    ),
    Command("plan", "models.commands.plan", "plan the goals that lead the tip along a path"),
    Command("goalmap", "models.commands.goalmap", "map places of the tip to goals at rest"),
    Command("linearise", "models.commands.linearise", "linearise the twin for python-control"),
    Command("train", "models.commands.train", "train the predictors, write a bundle"),
    Command("sign", "models.commands.sign", "sign a bundle for robots that name the key"),
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run `python -m models`."""
    return dispatch("python -m models", __doc__ or "", COMMANDS, argv)


if __name__ == "__main__":
    sys.exit(main())
