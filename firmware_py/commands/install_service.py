"""Write a systemd unit that may be real-time and a udev rule for the adapter's latency timer."""

from __future__ import annotations

import argparse
import getpass
import sys
from pathlib import Path
from typing import Final

from firmware_py.config import read_config
from firmware_py.console import DONE, emit
from firmware_py.errors import InputError

EXAMPLE = "sudo dropstitch install-service --config robot.toml --user robot"

UNIT_PATH: Final = "etc/systemd/system/dropstitch.service"
RULE_PATH: Final = "etc/udev/rules.d/99-dropstitch.rules"

_UNIT: Final = """\
[Unit]
Description=Control loop of the inflatable link

[Service]
# A robot does not start to move by itself: no [Install] section, no restart.
Type=exec
Restart=no
User={user}
SupplementaryGroups=dialout
ExecStart={python} -m firmware_py run --config {config}
# The loop's thread asks for SCHED_FIFO itself; a policy here would promote every thread.
AmbientCapabilities=CAP_SYS_NICE CAP_IPC_LOCK
LimitRTPRIO=99
LimitMEMLOCK=infinity
# SIGTERM brings the robot to a controlled stop; the recorder ends by itself afterwards.
KillMode=mixed
TimeoutStopSec=15
"""

_RULE: Final = """\
# FTDI adapters (U2D2, USB2Dynamixel) hold bytes back for 16 ms unless told otherwise.
ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("--config", type=Path, required=True, metavar="ROBOT.toml")
    parser.add_argument("--user", default=getpass.getuser(), help="who the service runs as")
    parser.add_argument("--root", type=Path, default=Path("/"), help="where to write")
    parser.add_argument("--dry-run", action="store_true", help="show the files, write nothing")


def run(args: argparse.Namespace) -> int:
    """Write both files, or show them."""
    config = args.config.resolve()
    read_config(config)
    unit = _UNIT.format(user=args.user, python=sys.executable, config=config)
    files = {UNIT_PATH: unit, RULE_PATH: _RULE}
    if args.dry_run:
        text = "\n".join(f"# {args.root / name}\n{content}" for name, content in files.items())
        emit(args, {"files": files, "written": False}, text)
        return DONE
    for name, content in files.items():
        path = args.root / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(content, encoding="utf-8")
        except OSError as error:
            raise InputError(
                path, f"cannot be written ({error.strerror})", "run it with sudo, or --dry-run"
            ) from None
    emit(
        args,
        {"files": files, "written": True},
        "written: " + ", ".join(str(args.root / name) for name in files) + "\n"
        "next: sudo systemctl daemon-reload && sudo udevadm control --reload && "
        "sudo udevadm trigger; then sudo systemctl start dropstitch",
    )
    return DONE
