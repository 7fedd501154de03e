"""Conventions that hold for every command line: version, help, exit codes."""

import contextlib
import io
import os
import re
import signal
import tomllib
from pathlib import Path

import firmware_py.__main__
import pytest

import firmware_py
import fmu.__main__
import hil.__main__
import models.__main__
from firmware_py import console
from firmware_py.errors import InputError, SafetyTrip

ROOMS = {
    "firmware_py": firmware_py.__main__,
    "models": models.__main__,
    "fmu": fmu.__main__,
    "hil": hil.__main__,
}
COMMANDS = [(name, command.name) for name, room in ROOMS.items() for command in room.COMMANDS]


@pytest.mark.parametrize("room", ROOMS)
def test_every_command_line_tells_the_version(room, capsys):
    assert ROOMS[room].main(["--version"]) == 0
    assert capsys.readouterr().out == f"dropstitch {firmware_py.__version__}\n"


@pytest.mark.parametrize(("room", "command"), COMMANDS)
def test_every_sub_command_tells_the_version(room, command, capsys):
    assert ROOMS[room].main([command, "--version"]) == 0
    assert capsys.readouterr().out == f"dropstitch {firmware_py.__version__}\n"


def test_the_version_has_one_source_and_an_entry_in_the_changelog():
    root = Path(__file__).parents[2]
    project = tomllib.loads((root / "pyproject.toml").read_text())
    assert "version" not in project["project"]
    assert project["tool"]["hatch"]["version"]["path"] == "firmware_py/__init__.py"
    assert re.search(
        rf"^## \[?{re.escape(firmware_py.__version__)}\b", (root / "CHANGELOG.md").read_text(), re.M
    )


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (InputError("file", "is missing", "copy it"), 2, "tool: file: is missing; copy it.\n"),
        (SafetyTrip("joint 1 jumped"), 1, "tool: stopped: joint 1 jumped\n"),
        (KeyboardInterrupt(), 130, "tool: interrupted\n"),
        (console.Terminated(), 143, "tool: terminated\n"),
        (
            BrokenPipeError(),
            2,
            "tool: pipe: was closed by the process at its other end; repeat the command.\n",
        ),
    ],
)
def test_errors_become_exit_codes_and_one_sentence(error, code, message, capsys, monkeypatch):
    def fail(args):
        raise error

    monkeypatch.setattr("firmware_py.commands.release.run", fail)
    commands = (console.Command("go", "firmware_py.commands.release", "a command"),)
    assert console.dispatch("tool", "", commands, ["go", "--config", "robot.toml"]) == code
    assert capsys.readouterr().err == message


@pytest.mark.parametrize("turned", [False, True])
def test_an_interrupt_while_a_command_is_loaded_is_one_sentence(capsys, monkeypatch, turned):
    def interrupt(name):
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            if turned:  # as libraries in C do
                raise ImportError("initialization failed") from None
            raise

    monkeypatch.setattr("firmware_py.console.importlib.import_module", interrupt)
    commands = (console.Command("go", "firmware_py.commands.release", "a command"),)
    of_the_tests = signal.signal(signal.SIGINT, signal.default_int_handler)  # may ignore it
    try:
        assert console.dispatch("tool", "", commands, ["go"]) == 130
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, of_the_tests)
    assert capsys.readouterr().err == "tool: interrupted\n"


def test_an_unknown_command_is_bad_input(capsys):
    assert ROOMS["firmware_py"].main(["fly"]) == console.BAD_INPUT
    assert "invalid choice" in capsys.readouterr().err


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

    def dispatched(action):
        monkeypatch.setattr(console.importlib, "import_module", lambda _: Echo(action))
        return console.dispatch("tool", "", [console.Command("echo", "m", "")], ["echo"])

    return dispatched


def test_a_full_disk_is_one_sentence(dispatched, capsys, monkeypatch):
    def full(_):
        raise OSError(28, "No space left on device", "/data/run.csv")

    assert dispatched(full) == 2
    said = capsys.readouterr().err
    assert (
        said.startswith("tool: /data/run.csv: No space left on device; ") and said.count("\n") == 1
    )


def test_a_full_standard_output_is_one_sentence(dispatched, capsys, monkeypatch):
    with open("/dev/full", "w") as full:
        monkeypatch.setattr("sys.stdout", full)
        assert dispatched(lambda _: print("result") or 0) == 2
        monkeypatch.undo()
    said = capsys.readouterr().err
    assert said.startswith("tool: output: No space left on device; ") and said.count("\n") == 1


@pytest.fixture
def without_readers(monkeypatch):
    """Call that gives the standard streams pipes without a reader, stderr one without a buffer."""
    with contextlib.ExitStack() as stack:

        def without_readers():
            for name, buffering in (("stdout", -1), ("stderr", 1)):
                reader, writer = os.pipe()
                os.close(reader)
                stream = stack.enter_context(open(writer, "w", buffering=buffering))
                monkeypatch.setattr(f"sys.{name}", stream)

        yield without_readers
        monkeypatch.undo()


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
    dispatched, without_readers, verdict
):
    done = []
    without_readers()
    assert dispatched(a_job_with_progress(verdict, done)) == verdict
    assert done == ["file"]


def test_a_refusal_that_nobody_reads_keeps_its_exit_code(dispatched, without_readers):
    def refused(_):
        raise InputError("file", "is missing", "copy it")

    without_readers()
    assert dispatched(refused) == 2


def test_a_command_works_without_standard_streams(dispatched, monkeypatch):
    for name in ("stdin", "stdout", "stderr"):
        monkeypatch.setattr(f"sys.{name}", None)
    done = []
    assert dispatched(a_job_with_progress(console.NEGATIVE, done)) == 1
    console.Progress("job", 1).step("of a program without streams")
    assert done == ["file"]


def test_sigterm_is_raised_once_in_the_block_and_has_its_old_effect_afterwards():
    of_the_tests = signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        with pytest.raises(console.Terminated), console.terminations_raised():
            try:
                signal.raise_signal(signal.SIGTERM)
            finally:
                signal.raise_signal(signal.SIGTERM)  # as `timeout` does: the clean-up goes on
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # whoever handles it keeps to that
        with console.terminations_raised():
            signal.raise_signal(signal.SIGTERM)
    finally:
        signal.signal(signal.SIGTERM, of_the_tests)


def test_a_sign_that_a_terminal_lacks_is_escaped(dispatched, monkeypatch):
    stream = io.BytesIO()
    monkeypatch.setattr("sys.stdout", io.TextIOWrapper(stream, encoding="ascii"))
    assert dispatched(lambda _: print("12 µs") or 0) == 0
    assert stream.getvalue() == b"12 \\xb5s\n"


def test_memory_that_is_not_there_is_one_sentence(dispatched, capsys):
    def large(_):
        raise MemoryError

    assert dispatched(large) == 2
    assert capsys.readouterr().err == "tool: echo: needs more memory than there is; give less.\n"


def test_a_job_that_finds_its_total_as_it_goes_never_counts_beyond_it(capsys):
    progress = console.Progress("gap", 0)
    for further in (2, 4, 3, 2, 1, 0):
        progress.step("part", further)
        assert progress.total == progress.done + further
    assert capsys.readouterr().err.splitlines()[-1].startswith("gap 6/6 ")


def test_a_total_that_is_estimated_says_so_until_it_is_known(capsys, monkeypatch):
    monkeypatch.setattr(console.time, "monotonic", iter(range(0, 100, 10)).__next__)
    progress = console.Progress("identify", 130, is_estimate=True)
    progress.step("fit")
    progress.total = progress.done + 1
    progress.step("done")
    counted = [line.split()[1] for line in capsys.readouterr().err.splitlines()]
    assert counted == ["1/~130", "2/2"]


def test_a_job_whose_first_step_takes_long_is_shown_at_its_beginning(capsys):
    progress = console.Progress("calibrate", 3)
    progress.begin("each takes minutes")
    assert " ".join(capsys.readouterr().err.split()) == "calibrate 0/3 0.0 s each takes minutes"
    assert progress.done == 0
