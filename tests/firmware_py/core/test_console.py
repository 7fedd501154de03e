"""Conventions that hold for every command line: version, help, exit codes."""

import contextlib
import importlib
import io
import os
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import firmware_py
import fmu.__main__
import hil.__main__
import models.__main__
from dropstitch.__main__ import main
from firmware_py.commands.command_table import COMMANDS
from firmware_py.core import console
from firmware_py.core.errors import InputError, SafetyTrip
from firmware_py.core.standard_streams import LastingStream
from tests.house.page_commands import parse

ROOT = Path(__file__).parents[3]
ROOMS = {"models": models.__main__, "fmu": fmu.__main__, "hil": hil.__main__}


@pytest.mark.parametrize("words", [[], ["replay"]])
def test_the_program_and_its_commands_show_the_version(words, capsys):
    assert main([*words, "--version"]) == 0
    assert capsys.readouterr().out == f"dropstitch {firmware_py.__version__}\n"


def test_a_family_of_commands_wants_one_of_them(capsys):
    assert main(["fmu"]) == main(["fmu", "fly"]) == console.BAD_INPUT
    assert "invalid choice: 'fly' (choose from" in capsys.readouterr().err


@pytest.mark.parametrize("command", COMMANDS, ids=lambda c: c.name)
def test_every_command_has_help_with_an_example_that_its_parser_accepts(command, capsys):
    assert main([*command.name.split(), "--help"]) == 0
    usage, _, example = capsys.readouterr().out.partition("example:\n")
    assert usage.startswith(f"usage: dropstitch {command.name} [-h]") and "--quiet" in usage
    words = shlex.split(example)
    words = words[words.index("dropstitch") + 1 :]
    assert console.chosen_command(COMMANDS, words) == command
    assert parse(words) is not None


@pytest.mark.parametrize(
    ("room", "words", "name"),
    [
        ("models", ["import"], "import"), ("fmu", ["build"], "fmu build"),
        ("hil", ["report"], "report build"),
    ],
)  # fmt: skip
def test_a_room_runs_its_own_commands_alone(room, words, name, monkeypatch, capsys):
    command = next(c for c in COMMANDS if c.name == name)
    module, ran = importlib.import_module(command.module), []
    monkeypatch.setattr(module, "configure", lambda parser: None)
    monkeypatch.setattr(module, "run", lambda args: ran.append(name) or console.DONE)
    assert ROOMS[room].main(words) == 0 and ran == [name]
    assert ROOMS[room].main(["replay"]) == console.BAD_INPUT
    assert "invalid choice: 'replay'" in capsys.readouterr().err


class Echo:
    """A command that prints, or raises."""

    EXAMPLE = "echo"

    def __init__(self, action):
        self.run = action

    def configure(self, parser):
        pass


@pytest.fixture
def dispatched(monkeypatch):
    """Exit code of a command that does something."""

    def dispatched(action, *options):
        monkeypatch.setattr(console.importlib, "import_module", lambda _: Echo(action))
        commands = [console.Command("", "echo", "m", "")]
        return console.dispatch("tool", "", commands, ["echo", *options])

    return dispatched


def lacking(name):
    return ModuleNotFoundError(f"No module named {name!r}", name=name)


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (InputError("file", "is missing", "copy it"), 2, "file: is missing; copy it."),
        (SafetyTrip("joint 1 jumped"), 1, "stopped: joint 1 jumped"),
        (KeyboardInterrupt(), 130, "interrupted"),
        (console.Terminated(), 143, "terminated"),
        (BrokenPipeError(), 2, "pipe: was closed by the process at its other end; "),
        (MemoryError(), 2, "echo: needs more memory than there is; give less."),
        (OSError(28, "No space left on device", "/data/run.csv"), 2, "/data/run.csv: No space"),
        (lacking("models.trials"), 2, "echo: belongs to the workshop, which is not installed"),
        (lacking("casadi"), 2, "echo: needs casadi, which is not installed here; "),
    ],
)
def test_errors_become_exit_codes_and_one_sentence(
    dispatched, error, code, message, capsys, monkeypatch
):
    def fail(_):
        raise error

    monkeypatch.setattr(console.importlib.util, "find_spec", lambda name: None)
    assert dispatched(fail) == code
    shown = capsys.readouterr().err
    assert shown.startswith(f"tool: {message}") and shown.count("\n") == 1


def test_a_missing_module_of_an_installed_package_is_an_internal_error(dispatched):
    def fail(_):
        raise lacking("models.nothing")

    with pytest.raises(ModuleNotFoundError):
        dispatched(fail)


# --- interrupts ---------------------------------------------------------------------------------

INTERRUPTED = """
import sys
class Pressed:
    def find_spec(name, path=None, target=None):
        if name == "firmware_py.core.console":
            raise {error}
sys.meta_path.insert(0, Pressed)
import {room}.__main__
"""


@pytest.mark.parametrize("room", ["dropstitch", "hil"])
def test_an_interrupt_during_the_imports_is_one_sentence(room):
    def started(error):
        code = INTERRUPTED.format(room=room, error=error)
        return subprocess.run(
            [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True
        )

    ended = started("KeyboardInterrupt")
    assert ended.stderr == "dropstitch: interrupted\n"
    assert ended.returncode in (-2, 130)  # Python ends itself by SIGINT: 130 in a shell
    ended = started("ZeroDivisionError")
    assert (ended.returncode, "Traceback" in ended.stderr) == (1, True)


@pytest.mark.parametrize("turned", [False, True])
def test_an_interrupt_while_a_command_is_loaded_is_one_sentence(capsys, monkeypatch, turned):
    def interrupt(name):
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            if turned:  # as libraries in C do
                raise ImportError("initialization failed") from None
            raise

    monkeypatch.setattr("firmware_py.core.console.importlib.import_module", interrupt)
    commands = (console.Command("", "go", "firmware_py.commands.release", "a command"),)
    of_the_tests = signal.signal(signal.SIGINT, signal.default_int_handler)  # may ignore it
    try:
        assert console.dispatch("tool", "", commands, ["go"]) == 130
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, of_the_tests)
    assert capsys.readouterr().err == "tool: interrupted\n"


def test_sigterm_is_raised_once_in_the_block_and_has_its_old_effect_afterwards():
    of_the_tests = signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        with pytest.raises(console.Terminated), console.terminations_raised():
            try:
                signal.raise_signal(signal.SIGTERM)
            finally:
                signal.raise_signal(signal.SIGTERM)  # as `timeout` does: the clean-up goes on
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # a handler that is set stays
        with console.terminations_raised():
            signal.raise_signal(signal.SIGTERM)
    finally:
        signal.signal(signal.SIGTERM, of_the_tests)


# --- standard streams ---------------------------------------------------------------------------


def a_job_with_progress(verdict, done):
    """A command that shows its progress, does its work, and prints its result."""

    def run(_):
        progress = console.Progress("job", 2)
        progress.step("begun")
        print("warning", file=console.sys.stderr)
        done.append("file")
        progress.step("written")
        print("result", flush=True)
        return verdict

    return run


@pytest.mark.parametrize("verdict", [console.DONE, console.NEGATIVE, console.INCONCLUSIVE])
def test_a_reader_that_goes_away_changes_neither_the_work_nor_its_exit_code(
    dispatched, monkeypatch, verdict
):
    done = []
    with contextlib.ExitStack() as stack:
        for name, buffering in (("stdout", -1), ("stderr", 1)):
            reader, writer = os.pipe()
            os.close(reader)
            stream = stack.enter_context(open(writer, "w", buffering=buffering))
            monkeypatch.setattr(f"sys.{name}", stream)
        assert dispatched(a_job_with_progress(verdict, done)) == verdict
        monkeypatch.undo()
    assert done == ["file"]


def test_a_command_works_without_standard_streams(dispatched, monkeypatch):
    for name in ("stdin", "stdout", "stderr"):
        monkeypatch.setattr(f"sys.{name}", None)
    done = []
    assert dispatched(a_job_with_progress(console.NEGATIVE, done)) == 1
    console.Progress("job", 1).step("of a program without streams")
    assert done == ["file"]


def test_quiet_hides_progress_and_nothing_else(dispatched, capsys):
    job = a_job_with_progress(console.DONE, [])
    assert dispatched(job, "-q") == dispatched(job, "--quiet") == 0
    shown = capsys.readouterr()
    assert shown.err == "warning\n" * 2 and shown.out == "result\n" * 2
    assert dispatched(job) == 0
    assert "job 2/2" in capsys.readouterr().err


def test_a_full_disk_is_an_error_of_the_stream_that_carries_the_result_alone(
    dispatched, capsys, monkeypatch
):
    with open("/dev/full", "w") as full:
        print("progress", file=LastingStream(full), flush=True)
    with open("/dev/full", "w") as full, pytest.raises(OSError, match="No space"):
        print("result", file=LastingStream(full, carries_result=True), flush=True)
    with open("/dev/full", "w") as full:
        monkeypatch.setattr("sys.stdout", full)
        assert dispatched(lambda _: print("result") or 0) == 2
        monkeypatch.undo()
    shown = capsys.readouterr().err
    assert shown.startswith("tool: output: No space left on device; ") and shown.count("\n") == 1


def test_a_sign_that_a_terminal_lacks_is_escaped(dispatched, monkeypatch):
    stream = io.BytesIO()
    monkeypatch.setattr("sys.stdout", io.TextIOWrapper(stream, encoding="ascii"))
    assert dispatched(lambda _: print("12 µs") or 0) == 0
    assert stream.getvalue() == b"12 \\xb5s\n"


def test_progress_never_counts_beyond_its_total_and_marks_an_estimate(capsys, monkeypatch):
    progress = console.Progress("gap", 0)
    for further in (2, 4, 3, 2, 1, 0):
        progress.step("part", further)
        assert progress.total == progress.done + further
    assert capsys.readouterr().err.splitlines()[-1].startswith("gap 6/6 ")
    monkeypatch.setattr(console.time, "monotonic", iter(range(0, 100, 10)).__next__)
    progress = console.Progress("identify", 130, is_estimate=True)
    progress.step("fit")
    progress.total = progress.done + 1
    progress.step("done")
    counted = [line.split()[1] for line in capsys.readouterr().err.splitlines()]
    assert counted == ["1/~130", "2/2"]


# --- completion ---------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("dropstitch sim", {"simulate"}),
        ("dropstitch fmu ", {"-h", "--help", "build", "check", "simulate", "ssp"}),
        ("dropstitch import --as ", {"motive", "c3d", "rosbag", "recording", "table"}),
    ],
)
def test_a_shell_gets_the_words_that_may_follow(line, offered, tmp_path):
    answer = tmp_path / "answer"
    asked = {
        "_ARGCOMPLETE": "1", "_ARGCOMPLETE_IFS": "\n", "_ARGCOMPLETE_SUPPRESS_SPACE": "1",
        "_ARGCOMPLETE_STDOUT_FILENAME": str(answer), "COMP_TYPE": "9",
        "COMP_LINE": line, "COMP_POINT": str(len(line)),
    }  # fmt: skip
    code = "import sys; from dropstitch.__main__ import main; sys.exit(main())"
    done = subprocess.run([sys.executable, "-c", code], env=os.environ | asked, check=False)
    assert done.returncode == 0
    assert set(answer.read_text().split("\n")) == offered
