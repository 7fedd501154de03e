"""Installation of a systemd service with real-time rights and of a udev rule for USB adapters."""

from __future__ import annotations

import argparse
import getpass
import os
import sys
from pathlib import Path
from typing import Final

from firmware_py.config import RobotConfig, read_config
from firmware_py.console import DONE, emit
from firmware_py.errors import InputError

EXAMPLE = "sudo dropstitch install-service --config robot.toml --user robot"

SERVICE_PATH: Final = "etc/systemd/system/dropstitch.service"
RULE_PATH: Final = "etc/udev/rules.d/99-dropstitch.rules"

_SERVICE: Final = """\
[Unit]
Description=Control loop of the inflatable link
# A robot must not start to move by itself: no [Install] section, no restart.

[Service]
# Started once the servos have passed every check and the first tick has run.
Type=notify
NotifyAccess=main
TimeoutStartSec=60
Restart=no
User={user}
SupplementaryGroups=dialout
ExecStart={command} run --config {config}
# The loop notifies systemd that it is alive. A process that hangs or is killed cannot switch the
# torque off: ExecStopPost does it after every end of the loop.
WatchdogSec=2
WatchdogSignal=SIGKILL
ExecStopPost={command} release --config {config}
# SIGTERM brings the robot to a controlled stop; the recorder ends by itself afterwards.
KillMode=mixed
TimeoutStopSec=20

# The loop's thread asks for SCHED_FIFO itself; a policy here would promote every thread.
AmbientCapabilities=CAP_SYS_NICE CAP_IPC_LOCK
LimitRTPRIO=99
LimitMEMLOCK=infinity
# {affinity_is}
CPUAffinity={affinity}
"""

_RULE: Final = """\
# FTDI adapters (U2D2, USB2Dynamixel) hold received bytes for up to 16 ms by default.
ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("--config", type=Path, required=True, metavar="ROBOT.toml")
    parser.add_argument(
        "--user", default=os.environ.get("SUDO_USER") or getpass.getuser(),
        help="user of the service (default: the one who called sudo)",
    )  # fmt: skip
    parser.add_argument(
        "--root", type=Path, default=Path("/"), help="root of the file system to write to"
    )
    parser.add_argument("--dry-run", action="store_true", help="print the files, write nothing")


def run(args: argparse.Namespace) -> int:
    """Write both files, or print them.

    Parameters
    ----------
    args : Namespace
        Arguments of `configure`.

    Raises
    ------
    InputError
        If the configuration is refused or a file cannot be written.
    """
    path = args.config.resolve()
    files = {SERVICE_PATH: service_file(read_config(path), path, args.user), RULE_PATH: _RULE}
    if args.dry_run:
        text = "\n".join(f"# {args.root / name}\n{content}" for name, content in files.items())
        emit(args, {"files": files, "written": False}, text)
        return DONE
    if args.root == Path("/") and os.geteuid() != 0:
        raise InputError(
            "install-service", "writes to /etc, which needs root", "run it with sudo, or --dry-run"
        )
    for name, content in files.items():
        _write(args.root / name, content)
    emit(
        args,
        {"files": files, "written": True},
        "written: " + ", ".join(str(args.root / name) for name in files) + "\n"
        "next: sudo systemctl daemon-reload && sudo udevadm control --reload && "
        "sudo udevadm trigger --action=add --subsystem-match=usb-serial; "
        "then sudo systemctl start dropstitch",
    )
    return DONE


def service_file(
    config: RobotConfig, path: Path, user: str, processors: frozenset[int] | None = None
) -> str:
    """Return the text of the systemd service file.

    Parameters
    ----------
    config : RobotConfig
        With `real_time.cpu` the loop's thread has that processor to itself: the affinity of the
        service excludes it for everything else.
    path : Path
        The configuration's absolute path.
    user : str
        User of the service.
    processors : frozenset of int, optional
        Processors of the machine; by default those that the kernel reports.
    """
    processors = processors or frozenset(range(os.cpu_count() or 1))
    own = config.real_time.cpu
    others = processors - {own}
    affinity_is = (
        f"The recorder and every other thread; the loop's own goes to processor {own} by itself."
        if own in processors and others
        else "All there are; real_time.cpu in the configuration keeps one for the loop alone."
    )
    return _SERVICE.format(
        user=user, command=f"{_quoted(sys.executable)} -m firmware_py", config=_quoted(path),
        affinity_is=affinity_is, affinity=" ".join(map(str, sorted(others or processors))),
    )  # fmt: skip


def _quoted(path: Path | str) -> str:
    """Return a path as one word of a systemd command line (systemd.service(5))."""
    text = str(path).replace("\\", "\\\\").replace('"', '\\"').replace("%", "%%").replace("$", "$$")
    return f'"{text}"' if set(text) & set(" \t'\"") else text


def _write(path: Path, content: str) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content, encoding="utf-8")
    except OSError as error:
        raise InputError(
            path, f"cannot be written ({error.strerror})", "run it with sudo, or --dry-run"
        ) from None
