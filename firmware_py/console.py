"""Command-line conventions of every room: sub-commands, exit codes, progress, JSON, version.

A command is a module with three names::

    EXAMPLE: str                                   # one line shown under --help
    def configure(parser: ArgumentParser) -> None  # its arguments
    def run(args: Namespace) -> int                # does the work, returns the exit code

It is imported only when it is called, so `--help` of a room costs nothing.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import io
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from types import FrameType
from typing import Any, Final, NamedTuple

from firmware_py import __version__
from firmware_py.errors import InputError, SafetyTrip

DONE, NEGATIVE, BAD_INPUT, INCONCLUSIVE = 0, 1, 2, 3
_INTERRUPTED: Final = 130
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
    """

    name: str
    module: str
    summary: str


def dispatch(
    prog: str, description: str, commands: Sequence[Command], argv: Sequence[str] | None
) -> int:
    """Run the sub-command that `argv` names.

    Parameters
    ----------
    prog, description : str
        Name of the command line and its help text.
    commands : sequence of Command
        The sub-commands.
    argv : sequence of str or None
        Arguments without the name of the program; None takes those of the process.

    Returns
    -------
    int
        0 done, 1 ran and the verdict is negative, 2 bad input, 3 inconclusive.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    chosen = next((c for c in commands if arguments and c.name == arguments[0]), None)
    parser = argparse.ArgumentParser(prog=prog, description=description)
    parser.add_argument("--version", action="version", version=_VERSION)
    subparsers = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a sign that a terminal lacks must not end a run
            stream.reconfigure(errors="backslashreplace")
    try:
        with _interrupts_kept():
            module = _declared(subparsers, commands, chosen)
            args = parser.parse_args(arguments)
            code = int(module.run(args)) if module else BAD_INPUT
        sys.stdout.flush()
        return code
    except SystemExit as exit_:  # argparse: 0 after --help, 2 after a usage error
        try:
            sys.stdout.flush()
        except OSError:
            silence_stdout()
            return BAD_INPUT
        return exit_.code if isinstance(exit_.code, int) else BAD_INPUT
    except InputError as error:
        print(f"{prog}: {error}", file=sys.stderr)
        return BAD_INPUT
    except SafetyTrip as error:
        print(f"{prog}: stopped: {error}", file=sys.stderr)
        return NEGATIVE
    except KeyboardInterrupt:
        print(f"{prog}: interrupted", file=sys.stderr)
        return _INTERRUPTED
    except BrokenPipeError:
        silence_stdout()
        return DONE
    except OSError as error:  # a full disk, a directory that may not be written, a closed stream
        print(f"{prog}: {_refused_by_system(error)}", file=sys.stderr)
        return BAD_INPUT
    except MemoryError:
        wrong = f"{arguments[0]}: needs more memory than there is; give less."
        print(f"{prog}: {wrong}", file=sys.stderr)
        return BAD_INPUT


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
    if error.filename is None:
        silence_stdout()
    return InputError(
        "output" if error.filename is None else str(error.filename),
        error.strerror or str(error) or "cannot be used",
        "check the name, its permissions and the space on its disk",
    )


def silence_stdout() -> None:
    """Discard what standard output still holds: it would fail again at the exit of Python."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


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
    """Print the result of a command on stdout.

    Parameters
    ----------
    args : Namespace
        The command's arguments.
    data : dict
        Result for machines, printed as JSON under --json.
    text : str
        Result for people, printed otherwise.
    """
    print(json.dumps(data, indent=1, sort_keys=True) if args.json else text)


class Progress:
    """Progress display of a long job, one line on stderr.

    Parameters
    ----------
    label : str
        Name of the job.
    total : int
        Number of steps.
    is_estimate : bool
        Whether the total is estimated; shown as such until the last step.
    """

    def __init__(self, label: str, total: int, is_estimate: bool = False) -> None:
        self.label, self.total, self.done, self.is_estimate = label, total, 0, is_estimate
        self._start_s, self._tty = time.monotonic(), sys.stderr.isatty()
        self._shown_s = 0.0

    def step(self, detail: str = "", further: int | None = None) -> None:
        """Count one finished step; show it every 0.1 s on a terminal, every 5 s in a file.

        Parameters
        ----------
        detail : str
            Text at the end of the line.
        further : int, optional
            Steps that follow, where only the job itself finds out; sets the total.
        """
        self.done += 1
        if further is not None:
            self.total = self.done + further
        now_s, last = time.monotonic(), self.done >= self.total
        if not last and now_s - self._shown_s < (0.1 if self._tty else 5.0):
            return
        self._shown_s = now_s
        of = f"{'~' if self.is_estimate and not last else ''}{self.total}"
        line = f"{self.label} {self.done}/{of} {now_s - self._start_s:5.1f} s {detail}"
        end = "\n" if last or not self._tty else "\r"
        print(line.ljust(79) if self._tty else line.rstrip(), end=end, file=sys.stderr, flush=True)
