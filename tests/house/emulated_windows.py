"""Process that stands for one on Windows: it imports every module and calls every command.

Run as a program. The libraries of others are loaded as they are here; then what Windows lacks is
taken away, and the rooms are loaded again. Prints JSON: errors of imports by module, exit codes of
`--help` and exit code and stderr of the commands that need Linux.
"""

import contextlib
import importlib
import io
import json
import os
import pkgutil
import platform
import signal
import socket
import sys

from tests.house.sources import ROOMS

FAULTS = {"hil.faults.fault_table", "hil.faults.fault_docs", "hil.faults.campaign"}
"""The table of faults names signals of POSIX; `faults` and what writes its page read it."""

ABSENT_MODULES = ("fcntl", "grp", "posix", "pty", "pwd", "resource", "syslog", "termios", "tty")
PRESENT_SIGNALS = ("SIGABRT", "SIGFPE", "SIGILL", "SIGINT", "SIGSEGV", "SIGTERM")
ABSENT_IN_OS = (
    "fchmod", "fork", "forkpty", "getegid", "geteuid", "getgid", "getuid", "killpg", "mkfifo",
    "nice", "openpty", "pread", "setsid", "statvfs", "sysconf", "uname", "wait4", "waitpid",
    "WIFSIGNALED", "WTERMSIG",
)  # fmt: skip
ABSENT_IN_SOCKET = ("AF_UNIX", "MSG_NOSIGNAL", "SOCK_SEQPACKET", "socketpair")


def modules() -> list[str]:
    found = []
    for room in ROOMS:
        found += [m.name for m in pkgutil.walk_packages([room], f"{room}.")]
    return [name for name in found if name not in FAULTS]


def errors_of_imports() -> dict[str, str]:
    errors = {}
    for name in modules():
        try:
            importlib.import_module(name)
        except Exception as error:
            errors[name] = f"{type(error).__name__}: {error}"
    return errors


def become_windows() -> None:
    """Take away what Windows lacks, and the modules of the rooms."""
    sys.modules.update(dict.fromkeys(ABSENT_MODULES))  # type: ignore[arg-type]
    absent = [n for n in vars(os) if n.startswith(("sched_", "SCHED_")) or n in ABSENT_IN_OS]
    for name in absent:
        delattr(os, name)
    for name in [n for n in vars(signal) if n.startswith("SIG") and n[3] != "_"]:
        if name not in PRESENT_SIGNALS:
            delattr(signal, name)
    for name in ABSENT_IN_SOCKET:
        delattr(socket, name)
    sys.platform = "win32"
    platform.system, platform.machine = lambda: "Windows", lambda: "AMD64"
    os.environ["USERNAME"] = os.environ["USER"] = "robot"
    for name in [n for n in sys.modules if n.partition(".")[0] in ROOMS]:
        del sys.modules[name]


def call(line: str) -> tuple[int, str]:
    """Exit code and stderr of a command."""
    error = io.StringIO()
    with contextlib.redirect_stderr(error), contextlib.redirect_stdout(io.StringIO()):
        code = importlib.import_module("dropstitch.__main__").main(line.split())
    return code, error.getvalue()


def main() -> None:
    errors_of_imports()
    become_windows()
    imports = errors_of_imports()
    rows = importlib.import_module("firmware_py.commands.command_table").COMMANDS
    helps = {row.name: call(f"{row.name} --help") for row in rows}
    examples = {row.name: importlib.import_module(row.module).EXAMPLE for row in rows}
    refusals = {
        row.name: call(examples[row.name].partition("dropstitch ")[2])
        for row in rows if row.linux_only
    }  # fmt: skip
    print(json.dumps({"imports": imports, "helps": helps, "refusals": refusals}))


if __name__ == "__main__":
    main()
