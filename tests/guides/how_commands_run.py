"""How each command of the guides is tried: run, or parsed only, and why.

A command that no row knows fails the test, and so does a row that no command needs. Programs of
others and targets of make are looked up by `tests/house/page_commands.py`.
"""

from __future__ import annotations

from typing import Final

RUN: Final = {
    "new": "a twentieth of a second",
    "evaluate": "on one trial of the toy link in place of the rig's",
    "validate": "on one trial of the toy link in place of a recording",
    "sign": "on the bundle of the notebooks",
    "replay": "on the bundle of the notebooks; a log is replayed by test_robot_commands",
    "install-service": "it only prints with --dry-run; without, it is parsed",
    "doctor": "it only looks; the verdict on this machine may be negative",
}
"""Commands that are run as they stand, on small data at the places that they name."""

PARSED: Final = {
    "simulate": "a trial of the rig takes 2 s; run by tests/models/commands and a notebook",
    "import": "needs a recording; run by tests/models/trials/importers on ones it writes",
    "identify": "takes 10 s and more; run by tests/models/commands",
    "train": "takes 6 s; run by tests/models/study and the toy bundle",
    "gap": "takes a minute; run by a notebook as `diagnose`, and by tests/models/gap",
    "experiment": "takes minutes; run by tests/models/gap/experiment",
    "plan": "takes half a minute; run by tests/models/plan",
    "goalmap": "takes half a minute; run by tests/models/plan",
    "fmu build": "compiles for 4 s; run by tests/fmu",
    "fmu check": "needs a built FMU; run by tests/fmu",
    "fmu simulate": "needs a built FMU; run by tests/fmu",
    "sil": "needs a built FMU or the rig; run by tests/hil/sil",
    "emulate": "serves until it is ended; run by tests/hil/emulator",
    "run": "needs a robot; run by tests/firmware_py/test_robot_commands.py",
}
"""Commands that are too dear, or lack their data: their own parser has to take the arguments."""
