"""Command-line conventions: sub-commands, exit codes, progress, JSON, version, completion.

A command is a module with three names::

    EXAMPLE: str                                   # one line shown under --help
    def configure(parser: ArgumentParser) -> None  # its arguments
    def run(args: Namespace) -> int                # does the work, returns the exit code

It is imported only when it is called, so `dropstitch --help` costs nothing. What needs Linux is
refused elsewhere; its `--help` works on every system. Every command has --json, --quiet and
--version besides.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import importlib.util
import itertools
import os
import platform
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from types import FrameType
from typing import Any, ClassVar, Final, NamedTuple

from firmware_py import __version__
from firmware_py.core.errors import InputError, SafetyTrip
from firmware_py.core.standard_streams import LastingStream, lasting_streams

DONE, NEGATIVE, BAD_INPUT, INCONCLUSIVE = 0, 1, 2, 3
_INTERRUPTED: Final = 128 + signal.SIGINT
_TERMINATED: Final = 128 + signal.SIGTERM
_VERSION: Final = f"dropstitch {__version__}"
_ROOMS: Final = ("models", "fmu", "hil")
"""Packages that run from a checkout only; the robot's wheel lacks them."""


class Command(NamedTuple):
    """One row of the table of commands."""

    group: str  # Heading under which `--help` lists it
    name: str  # One word, or two for a command of a family, like "fmu build"
    module: str  # Module that implements it
    summary: str  # One line for `--help`
    linux_only: bool = False  # Whether it needs the loop, its bus or the emulated bus


def dispatch(
    prog: str, description: str, commands: Sequence[Command], argv: Sequence[str] | None
) -> int:
    """Run the command that `argv` names.

    `argv`: arguments without the name of the program; None takes those of the process.
    Returns 0 done, 1 ran and the verdict is negative, 2 bad input, 3 inconclusive; 130 and 143
    after Ctrl-C and SIGTERM. A reader of stdout or stderr that goes away does not change it.
    """
    if "_ARGCOMPLETE" in os.environ:
        return _complete(prog, description, commands)
    arguments = list(sys.argv[1:] if argv is None else argv)
    with lasting_streams():
        return _exit_code(prog, description, commands, arguments)


def _exit_code(
    prog: str, description: str, commands: Sequence[Command], arguments: list[str]
) -> int:
    """Run the command; turn what it raises into an exit code and one sentence on stderr."""
    chosen = chosen_command(commands, arguments)

    def say(sentence: object) -> None:
        print(f"{prog}: {sentence}", file=sys.stderr)

    try:
        with _interrupts_kept(), _packages_named(chosen):
            parser, module = _declared(prog, description, commands, chosen)
            args = parser.parse_args(arguments)
            _check_system(commands, chosen)
            code = _run(module, args) if module else BAD_INPUT
        sys.stdout.flush()
        return code
    except SystemExit as exit_:  # argparse: 0 after --help, 2 after a usage error
        try:
            sys.stdout.flush()
        except OSError:
            return BAD_INPUT
        return exit_.code if isinstance(exit_.code, int) else BAD_INPUT
    except InputError as error:
        say(error)
        return BAD_INPUT
    except SafetyTrip as error:
        say(f"stopped: {error}")
        return NEGATIVE
    except Terminated:
        say("terminated")
        return _TERMINATED
    except KeyboardInterrupt:
        say("interrupted")
        return _INTERRUPTED
    except OSError as error:  # a full disk, a directory that may not be written, a closed pipe
        say(_refused_by_system(error))
        return BAD_INPUT
    except MemoryError:
        say(f"{arguments[0]}: needs more memory than there is; give less.")
        return BAD_INPUT


def _run(module: Any, args: argparse.Namespace) -> int:
    Progress.shown = not args.quiet
    try:
        return int(module.run(args))
    finally:
        Progress.shown = True


def chosen_command(commands: Sequence[Command], words: Sequence[str]) -> Command | None:
    """Command that the first one or two words name, or None."""
    return next((c for c in commands if c.name.split() in ([*words[:1]], [*words[:2]])), None)


def _declared(
    prog: str, description: str, commands: Sequence[Command], chosen: Command | None
) -> tuple[argparse.ArgumentParser, Any]:
    """Parser of all commands, with arguments for the chosen one alone, and its module."""
    parser = argparse.ArgumentParser(prog, description=description, **_overview(prog, commands))
    parser.add_argument("--version", action="version", version=_VERSION)
    top = _choice(parser, prog)
    families: dict[str, Any] = {}
    module = None
    for command in commands:
        family, _, name = command.name.rpartition(" ")
        if family and family not in families:
            rows = [c for c in commands if c.name.startswith(f"{family} ")]
            of_family = f"{prog} {family}"
            inner = top.add_parser(family, **_overview(of_family, rows))
            families[family] = _choice(inner, of_family)
        choice = families[family] if family else top
        if command is not chosen:
            choice.add_parser(name, add_help=False)
            continue
        module = importlib.import_module(command.module)
        sub = choice.add_parser(
            name,
            description=module.__doc__,
            epilog=f"example:\n  {module.EXAMPLE}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,  # a script must not break when an option is added
        )
        module.configure(sub)
        sub.add_argument("--version", action="version", version=_VERSION)
        sub.add_argument("--json", action="store_true", help="print the result as JSON on stdout")
        sub.add_argument("-q", "--quiet", action="store_true", help="hide progress on stderr")
    return parser, module


def _overview(prog: str, rows: Sequence[Command]) -> dict[str, Any]:
    """Usage and help of a parser that lists commands by group."""
    width = max(len(row.name) for row in rows)
    groups = itertools.groupby(rows, key=lambda row: row.group)
    lines = [
        line
        for group, members in groups
        for line in (f"{group}:", *(f"  {row.name:<{width}}  {row.summary}" for row in members))
    ]
    return {
        "usage": f"{prog} COMMAND ...",
        "epilog": "\n".join(lines),
        "formatter_class": argparse.RawDescriptionHelpFormatter,
    }


def _choice(parser: argparse.ArgumentParser, prog: str) -> Any:
    return parser.add_subparsers(
        required=True, metavar="COMMAND", help=argparse.SUPPRESS, prog=prog
    )


def _complete(prog: str, description: str, commands: Sequence[Command]) -> int:
    """Answer the shell, which asks how its command line goes on (argcomplete's protocol)."""
    line = os.environ.get("COMP_LINE", "")[: int(os.environ.get("COMP_POINT", 0))]
    try:
        import argcomplete

        chosen = chosen_command(commands, line.split()[1:])
        parser, _ = _declared(prog, description, commands, chosen)
    except ImportError:  # nothing to offer
        return BAD_INPUT
    argcomplete.autocomplete(parser)
    return DONE


@contextlib.contextmanager
def _packages_named(chosen: Command | None) -> Iterator[None]:
    """Refuse in one sentence a command whose packages are not installed."""
    try:
        yield
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if chosen is None or not package or importlib.util.find_spec(package) is not None:
            raise
        if package in _ROOMS:
            what = "belongs to the workshop, which is not installed here"
        else:
            what = f"needs {package}, which is not installed here"
        raise InputError(
            chosen.name, what, "use it in a checkout of the project after 'make setup'"
        ) from None


def _check_system(commands: Sequence[Command], chosen: Command | None) -> None:
    """Refuse a command that this system does not run, and name all of those."""
    if chosen is None or not chosen.linux_only or sys.platform == "linux":
        return
    here = {"win32": "Windows", "darwin": "macOS"}.get(sys.platform, platform.system())
    others = ", ".join(c.name for c in commands if c.linux_only)
    raise InputError(
        chosen.name, f"runs on Linux only, and this is {here}",
        f"use a machine with Linux; {here} runs every command but {others}",
    )  # fmt: skip


class Terminated(KeyboardInterrupt):
    """SIGTERM during work that has other processes to end; handled as Ctrl-C is."""


@contextlib.contextmanager
def terminations_raised() -> Iterator[None]:
    """Raise `Terminated` for the first SIGTERM during the block (main thread only).

    For work that has other processes to end. Elsewhere SIGTERM keeps its default effect, which does
    not wait for a library in C, and the control loop has a handler of its own.
    """
    is_main = threading.current_thread() is threading.main_thread()
    if not is_main or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
        yield
        return

    def note(number: int, frame: FrameType | None) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # `timeout` sends it twice
        raise Terminated

    signal.signal(signal.SIGTERM, note)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


@contextlib.contextmanager
def _interrupts_kept() -> Iterator[None]:
    """Raise `KeyboardInterrupt` for Ctrl-C, also where a library in C makes another error of it."""
    before, interrupts = signal.getsignal(signal.SIGINT), list[int]()

    def note(number: int, frame: FrameType | None) -> None:
        interrupts.append(number)
        signal.default_int_handler(number, frame)

    ours = before is signal.default_int_handler
    ours = ours and threading.current_thread() is threading.main_thread()
    if ours:
        signal.signal(signal.SIGINT, note)
    try:
        yield
    except Exception:
        if interrupts:
            raise KeyboardInterrupt from None
        raise
    finally:
        if ours:
            signal.signal(signal.SIGINT, before)


def _refused_by_system(error: OSError) -> InputError:
    """Sentence for what the operating system refused."""
    if isinstance(error, BrokenPipeError):
        return InputError(
            "pipe", "was closed by the process at its other end", "repeat the command"
        )
    return InputError(
        "output" if error.filename is None else str(error.filename),
        error.strerror or str(error) or "cannot be used",
        "check the name, its permissions and the space on its disk",
    )


def emit(args: argparse.Namespace, data: dict[str, Any], text: str) -> None:
    if args.json:
        import json

        text = json.dumps(data, indent=1, sort_keys=True)
    print(text)


class Progress:
    """Progress display of a long job, one line on stderr.

    `is_estimate`: whether the total is estimated; shown as such until the last step.
    """

    shown: ClassVar[bool] = True
    """Whether progress is shown: --quiet hides that of the command."""

    def __init__(self, label: str, total: int, is_estimate: bool = False) -> None:
        self.label, self.total, self.done, self.is_estimate = label, total, 0, is_estimate
        self._stderr = LastingStream(sys.stderr)
        self._start_s, self._tty = time.monotonic(), self._stderr.isatty()
        self._shown_s = 0.0

    def begin(self, detail: str) -> None:
        """Show that no step has finished yet: the first may take minutes."""
        self._show(detail)

    def step(self, detail: str = "", further: int | None = None) -> None:
        """Count one finished step; show it every 0.1 s on a terminal, every 5 s in a file.

        `further`: steps that follow, where only the job itself finds out; sets the total.
        """
        self.done += 1
        if further is not None:
            self.total = self.done + further
        waited_s = time.monotonic() - self._shown_s
        if self.done >= self.total or waited_s >= (0.1 if self._tty else 5.0):
            self._show(detail)

    def _show(self, detail: str) -> None:
        if not self.shown:
            return
        now_s, last = time.monotonic(), self.done >= self.total
        self._shown_s = now_s
        of = f"{'~' if self.is_estimate and not last else ''}{self.total}"
        line = f"{self.label} {self.done}/{of} {now_s - self._start_s:5.1f} s {detail}"
        end = "\n" if last or not self._tty else "\r"
        self._stderr.write((line.ljust(79) if self._tty else line.rstrip()) + end)
        self._stderr.flush()
