"""Commands of `dropstitch`, all of them.

The table lies in the lowest room, because the robot's wheel and every room read it. It names the
module of a command and imports none, so that `dropstitch --help` costs nothing.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Final

from firmware_py.core.console import Command, chosen_command, dispatch

PROG: Final = "dropstitch"
DESCRIPTION: Final = (
    "Real-time controller, predictor and digital twin for a drop-stitch inflatable robot link."
)

_MODELS, _GAP = "models.commands", "models.commands.gap_workflow"
_FMU, _HIL, _ROBOT = "fmu.commands", "hil.commands", "firmware_py.commands"

COMMANDS: Final = (
    Command("trials", "new", f"{_MODELS}.new", "describe a link of your own"),
    Command("trials", "simulate", f"{_MODELS}.simulate", "run the rig, write trials"),
    Command("trials", "import", f"{_MODELS}.import_", "turn mocap and servo logs into trials"),
    Command("trials", "validate", f"{_MODELS}.validate", "check trials before a fit"),
    Command("plant", "identify", f"{_MODELS}.identify", "fit the plant to trials"),
    Command("plant", "evaluate", f"{_MODELS}.evaluate", "compare a plant with trials"),
    Command("plant", "gap", f"{_GAP}.gap", "find the effects that the plant lacks, add them"),
    Command("plant", "experiment", f"{_GAP}.experiment", "rank motions that separate look-alikes"),
    Command("predictor", "train", f"{_MODELS}.train", "train the predictors, write a bundle"),
    Command("predictor", "sign", f"{_MODELS}.sign", "sign a bundle for robots that name the key"),
    Command("tip", "plan", f"{_MODELS}.plan", "plan the goals that lead the tip along a path"),
    Command("tip", "goalmap", f"{_MODELS}.goalmap", "map places of the tip to goals at rest"),
    Command("tip", "linearise", f"{_MODELS}.linearise", "linearise the twin for python-control"),
    Command("FMU", "fmu build", f"{_FMU}.build", "build a twin, predictor or observer FMU"),
    Command("FMU", "fmu check", f"{_FMU}.check", "validate an FMU, compare it with the plant"),
    Command("FMU", "fmu simulate", f"{_FMU}.simulate", "step an FMU in FMPy and plot the run"),
    Command("FMU", "fmu ssp", f"{_FMU}.ssp", "package twin, observer and controller (SSP)"),
    Command("software in the loop", "sil", f"{_HIL}.sil",
            "run the robot's loop in software, judge its timing", linux_only=True),
    Command("software in the loop", "emulate", f"{_HIL}.emulate",
            "emulate servos for any Dynamixel program", linux_only=True),
    Command("software in the loop", "faults", f"{_HIL}.faults",
            "inject every fault, check what happens", linux_only=True),
    Command("software in the loop", "campaign", f"{_HIL}.campaign",
            "run many cases, here or on a cluster", linux_only=True),
    Command("report", "report build", f"{_HIL}.report", "page about everything in build/"),
    Command("report", "report gap", f"{_HIL}.gap", "page about a gap that was closed"),
    Command("report", "report plans", f"{_HIL}.plans", "page about plans that were run on the rig"),
    Command("robot", "run", f"{_ROBOT}.run", "run the control loop", linux_only=True),
    Command("robot", "doctor", f"{_ROBOT}.doctor", "check this PC, the bus and the joints",
            linux_only=True),
    Command("robot", "replay", f"{_ROBOT}.replay", "replay a log through a bundle"),
    Command("robot", "bench", f"{_ROBOT}.bench", "measure the tick's own cost", linux_only=True),
    Command("robot", "release", f"{_ROBOT}.release", "switch the torque of the servos off",
            linux_only=True),
    Command("robot", "install-service", f"{_ROBOT}.install_service", "write a systemd service",
            linux_only=True),
    Command("list", "list", "dropstitch.list_command",
            "show the effects, rigs or servos that there are"),
)  # fmt: skip


def run_alias(room: str, argv: Sequence[str] | None) -> int:
    """Run `python -m ROOM`: the room's commands under the names of their modules, or in full."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    rows = [c for c in COMMANDS if c.module.startswith(f"{room}.")]
    if arguments and chosen_command(rows, arguments) is None:
        of_module = {row.module.rpartition(".")[2].removesuffix("_"): row.name for row in rows}
        arguments[:1] = of_module.get(arguments[0], arguments[0]).split(" ")
    return dispatch(PROG, DESCRIPTION, rows, arguments)
