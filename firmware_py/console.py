"""Command-line conventions of every room: sub-commands, exit codes, progress, JSON, version.

A command is a module with three names::

    EXAMPLE: str                                   # one line shown under --help
    def configure(parser: ArgumentParser) -> None  # its arguments
    def run(args: Namespace) -> int                # does the work, returns the exit code

It is imported only when it is called, so `--help` of a room costs nothing. What needs Linux is
refused here elsewhere; its `--help` works on every system.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import json
import platform
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from types import FrameType
from typing import Any, Final, NamedTuple

from firmware_py import __version__
from firmware_py.errors import InputError, SafetyTrip
from firmware_py.files.standard_streams import LastingStream, lasting_streams

DONE, NEGATIVE, BAD_INPUT, INCONCLUSIVE = 0, 1, 2, 3
_INTERRUPTED: Final = 128 + signal.SIGINT
_TERMINATED: Final = 128 + signal.SIGTERM
_VERSION: Final = f"dropstitch {__version__}"


class Command(NamedTuple):
    """One row of a room's command table.

    Attributes
    ----------
    name : str
        Name of the sub-command.
    module : str
        Module that implements it.
    summary : str
        One line for `--help`.
    linux_only : bool
        Whether it needs the loop, its bus or the emulated bus, which no other system runs.
    """

    name: str
    module: str
    summary: str
    linux_only: bool = False


def dispatch(
    prog: str, description: str, commands: Sequence[Command], argv: Sequence[str] | None
) -> int:
    """Run the sub-command that `argv` names.

    `argv`: arguments without the name of the program; None takes those of the process.
    Returns 0 done, 1 ran and the verdict is negative, 2 bad input, 3 inconclusive; 130 and 143
    after Ctrl-C and SIGTERM. A reader of stdout or stderr that goes away does not change it.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    parser = argparse.ArgumentParser(prog=prog, description=description)
    parser.add_argument("--version", action="version", version=_VERSION)
    with lasting_streams():
        return _exit_code(parser, commands, arguments)


def _exit_code(
    parser: argparse.ArgumentParser, commands: Sequence[Command], arguments: list[str]
) -> int:
    """Run the command; turn what it raises into an exit code and one sentence on stderr."""
    chosen = next((c for c in commands if arguments and c.name == arguments[0]), None)
    subparsers = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def say(sentence: object) -> None:
        print(f"{parser.prog}: {sentence}", file=sys.stderr)

    try:
        with _interrupts_kept():
            module = _declared(subparsers, commands, chosen)
            args = parser.parse_args(arguments)
            _check_system(parser.prog, commands, chosen)
            code = int(module.run(args)) if module else BAD_INPUT
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


def _check_system(prog: str, commands: Sequence[Command], chosen: Command | None) -> None:
    """Refuse a command that this system does not run, and name what it does run."""
    if chosen is None or not chosen.linux_only or sys.platform == "linux":
        return
    here = {"win32": "Windows", "darwin": "macOS"}.get(sys.platform, platform.system())
    others = ", ".join(f"'{prog} {c.name}'" for c in commands if not c.linux_only)
    raise InputError(
        chosen.name, f"runs on Linux only, and this is {here}",
        f"use a machine with Linux; {here} runs {f'{others}, ' if others else ''}"
        "'python -m models' and 'python -m fmu'",
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

    own = before is signal.default_int_handler
    own = own and threading.current_thread() is threading.main_thread()
    if own:
        signal.signal(signal.SIGINT, note)
    try:
        yield
    except Exception:
        if interrupts:
            raise KeyboardInterrupt from None
        raise
    finally:
        if own:
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


def _declared(
    subparsers: argparse._SubParsersAction[argparse.ArgumentParser],
    commands: Sequence[Command],
    chosen: Command | None,
) -> Any:
    """Declare every sub-command; return the module of the chosen one."""
    module = None
    for command in commands:
        if command is not chosen:
            subparsers.add_parser(command.name, help=command.summary, add_help=False)
            continue
        module = importlib.import_module(command.module)
        sub = subparsers.add_parser(
            command.name,
            help=command.summary,
            description=module.__doc__,
            epilog=f"example:\n  {module.EXAMPLE}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        module.configure(sub)
        sub.add_argument("--version", action="version", version=_VERSION)
        sub.add_argument("--json", action="store_true", help="print the result as JSON on stdout")
    return module


def emit(args: argparse.Namespace, data: dict[str, Any], text: str) -> None:
    """Print the result of a command on stdout."""
    print(json.dumps(data, indent=1, sort_keys=True) if args.json else text)


class Progress:
    """Progress display of a long job, one line on stderr.

    `is_estimate`: whether the total is estimated; shown as such until the last step.
    """

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
        now_s, last = time.monotonic(), self.done >= self.total
        self._shown_s = now_s
        of = f"{'~' if self.is_estimate and not last else ''}{self.total}"
        line = f"{self.label} {self.done}/{of} {now_s - self._start_s:5.1f} s {detail}"
        end = "\n" if last or not self._tty else "\r"
        self._stderr.write((line.ljust(79) if self._tty else line.rstrip()) + end)
        self._stderr.flush()
