"""Installation of a systemd service with real-time rights and of a udev rule for USB adapters."""

from __future__ import annotations

import argparse
import contextlib
import getpass
import os
import re
import sys
import unicodedata
from pathlib import Path
from typing import Final

from firmware_py.config import RobotConfig, read_config
from firmware_py.core.console import DONE, emit
from firmware_py.core.errors import InputError
from firmware_py.core.input_files import resolved

if sys.platform != "win32":  # --help works on Windows
    import pwd

EXAMPLE = "sudo dropstitch install-service --config robot.toml --user robot"

SERVICE_PATH: Final = "etc/systemd/system/dropstitch.service"
RULE_PATH: Final = "etc/udev/rules.d/99-dropstitch.rules"

_USER: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_.@-]{0,63}")
"""Valid user names, including those of a directory service."""

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
CapabilityBoundingSet=CAP_SYS_NICE CAP_IPC_LOCK
LimitRTPRIO=99
LimitMEMLOCK=infinity
# {affinity_is}
CPUAffinity={affinity}

# The bundle is code: what it can reach is the port, its own files and the directory of the logs.
NoNewPrivileges=yes
ProtectSystem=strict
ProtectHome=read-only
ReadWritePaths={logs}
PrivateTmp=yes
{socket}DevicePolicy=closed
DeviceAllow=char-ttyUSB rw
DeviceAllow=char-ttyACM rw
DeviceAllow=char-ttyAMA rw
DeviceAllow=char-ttyS rw
DeviceAllow=char-pts rw
# 'run --live' needs a network: PrivateNetwork=no, and AF_INET AF_INET6 in the list.
PrivateNetwork=yes
RestrictAddressFamilies=AF_UNIX
IPAddressDeny=any
ProtectClock=yes
ProtectControlGroups=yes
ProtectHostname=yes
ProtectKernelLogs=yes
ProtectKernelModules=yes
ProtectKernelTunables=yes
ProtectProc=invisible
LockPersonality=yes
RemoveIPC=yes
RestrictNamespaces=yes
RestrictSUIDSGID=yes
SystemCallArchitectures=native
SystemCallFilter=@system-service
SystemCallErrorNumber=EPERM
UMask=0027
"""

_RULE: Final = """\
# FTDI adapters (U2D2, USB2Dynamixel) hold received bytes for up to 16 ms by default.
ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"
"""


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--config", type=Path, required=True, metavar="ROBOT", help="robot.toml")
    parser.add_argument(
        "--user", default=os.environ.get("SUDO_USER") or getpass.getuser(),
        help="user of the service (default: the one who called sudo)",
    )  # fmt: skip
    parser.add_argument(
        "--root", type=Path, default=Path("/"), help="root of the file system to write to"
    )
    parser.add_argument("--dry-run", action="store_true", help="print the files, write nothing")


def run(args: argparse.Namespace) -> int:
    """Write both files, or print them."""
    path = resolved(args.config)
    config = read_config(path)
    files = {SERVICE_PATH: service_file(config, path, args.user), RULE_PATH: _RULE}
    if args.dry_run:
        text = "\n".join(f"# {args.root / name}\n{content}" for name, content in files.items())
        emit(args, {"files": files, "written": False}, text)
        return DONE
    if args.root == Path("/") and os.geteuid() != 0:
        raise InputError(
            "install-service", "writes to /etc, which needs root", "run it with sudo, or --dry-run"
        )
    if args.root == Path("/"):
        _check_exists(args.user)
    for name, content in files.items():
        _write(args.root / name, content)
    logs = _logs(config, path)
    emit(
        args,
        {"files": files, "written": True},
        "written: "
        + ", ".join(str(args.root / name) for name in files)
        + "\n"
        + (f"next: make the directory {logs} as {args.user}\n" if _lacks(logs) else "")
        + "next: sudo systemctl daemon-reload && sudo udevadm control --reload && "
        "sudo udevadm trigger --action=add --subsystem-match=usb-serial; "
        "then sudo systemctl start dropstitch",
    )
    return DONE


def service_file(
    config: RobotConfig, path: Path, user: str, processors: frozenset[int] | None = None
) -> str:
    """Return the text of the systemd service file.

    With `real_time.cpu` the affinity of the service excludes this processor, so that the loop's
    thread has it exclusively.

    `processors`: processors of the machine; by default those that the kernel reports.
    """
    if not _USER.fullmatch(user):
        raise InputError(
            "--user", f"{user!r} is no user name", "give letters, digits, '_' and '-', like robot"
        )
    processors = processors or frozenset(range(os.cpu_count() or 1))
    loop_cpu = config.real_time.cpu
    others = processors - {loop_cpu}
    affinity_is = (
        f"The recorder and every other thread; the loop's own goes to processor {loop_cpu} itself."
        if loop_cpu in processors and others
        else "All there are; real_time.cpu in the configuration keeps one for the loop alone."
    )
    socket, port = "", config.bus.port
    if port.startswith("unix:"):  # an emulator's socket, which PrivateTmp would hide
        directory = Path(port.removeprefix("unix:")).absolute().parent
        socket = f"BindReadOnlyPaths={_optional(directory)}\n"
    return _SERVICE.format(
        user=user,
        command=f"{_quoted(sys.executable)} -m dropstitch",
        config=_quoted(path),
        affinity_is=affinity_is,
        affinity=" ".join(map(str, sorted(others or processors))),
        logs=_optional(_logs(config, path)),
        socket=socket,
    )


def _quoted(path: Path | str) -> str:
    """Return a path as one word of a systemd command line (systemd.service(5))."""
    wrong = ("Cc", "Zl", "Zp", "Cs")  # Cs: a byte that is not UTF-8
    if any(unicodedata.category(character) in wrong for character in str(path)):
        raise InputError(
            repr(str(path)), "has a line break or another control character, or is not UTF-8",
            "rename it",
        )  # fmt: skip
    text = str(path).replace("\\", "\\\\").replace('"', '\\"').replace("%", "%%").replace("$", "$$")
    return f'"{text}"' if set(text) & set(" \t'\"") else text


def _optional(path: Path) -> str:
    """Return an optional path as one word of a list of paths (systemd.exec(5))."""
    return _quoted(f"-{path}").replace("$$", "$")


def _logs(config: RobotConfig, path: Path) -> Path:
    return Path(os.path.abspath(path.parent / config.logs))


def _lacks(logs: Path) -> bool:
    """Whether the directory is missing, which the service cannot make."""
    return not logs.is_dir()


def _check_exists(user: str) -> None:
    try:
        pwd.getpwnam(user)
    except KeyError:
        raise InputError("--user", f"{user} does not exist", "name a user of this PC") from None


def _write(path: Path, content: str) -> None:
    """Write or replace a file, never through a symbolic link."""
    if path.is_symlink():
        raise InputError(
            path, f"is a symbolic link to {os.readlink(path)}", "remove it, if it is not needed"
        )
    new = path.with_name(f".{path.name}.new")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        new.unlink(missing_ok=True)
        handle = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(content)
        new.replace(path)  # replaces a link made meanwhile, does not follow it
    except OSError as error:
        with contextlib.suppress(OSError):
            new.unlink(missing_ok=True)
        raise InputError(
            path, f"cannot be written ({error.strerror})", "run it with sudo, or --dry-run"
        ) from None
