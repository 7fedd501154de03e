"""Conventions that hold for every command line: version, help, exit codes."""

import contextlib
import importlib
import io
import os
import shlex
import signal
import subprocess
import sys

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

ALIASES = {"models": models.__main__, "fmu": fmu.__main__, "hil": hil.__main__}


@pytest.mark.parametrize("words", [[], ["replay"]])
def test_the_program_and_its_commands_tell_the_version(words, capsys):
    assert main([*words, "--version"]) == 0
    assert capsys.readouterr().out == f"dropstitch {firmware_py.__version__}\n"


def test_the_help_lists_every_command_by_its_group(capsys):
    assert main(["--help"]) == 0
    shown = capsys.readouterr().out
    for command in COMMANDS:
        own = shown.split(f"\n{command.group}:\n")[1]
        assert f"  {command.name} " in own and command.summary in own


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
    ("family", "members"),
    [("fmu", ("build", "check", "simulate", "ssp")), ("report", ("build", "gap", "plans"))],
)
def test_a_family_lists_its_commands_and_wants_one(family, members, capsys):
    assert main([family, "--help"]) == 0
    shown = capsys.readouterr().out
    assert all(f"  {family} {name} " in shown for name in members) and "simulate  run" not in shown
    assert main([family]) == main([family, "fly"]) == console.BAD_INPUT
    assert "invalid choice: 'fly' (choose from" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("room", "words", "name"),
    [
        ("models", ["import"], "import"), ("fmu", ["build"], "fmu build"),
        ("fmu", ["fmu", "ssp"], "fmu ssp"), ("hil", ["sil"], "sil"), ("hil", ["gap"], "report gap"),
        ("hil", ["report"], "report build"), ("hil", ["report", "plans"], "report plans"),
    ],
)  # fmt: skip
def test_a_room_runs_its_commands_under_their_old_names(room, words, name, monkeypatch):
    command = next(c for c in COMMANDS if c.name == name)
    module, ran = importlib.import_module(command.module), []
    monkeypatch.setattr(module, "configure", lambda parser: None)
    monkeypatch.setattr(module, "run", lambda args: ran.append(name) or console.DONE)
    assert ALIASES[room].main(words) == 0 and ran == [name]


def test_a_room_has_no_commands_of_others(capsys):
    assert models.__main__.main(["sil"]) == console.BAD_INPUT
    assert "invalid choice: 'sil'" in capsys.readouterr().err


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
    commands = (console.Command("", "go", "firmware_py.commands.release", "a command"),)
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

    monkeypatch.setattr("firmware_py.core.console.importlib.import_module", interrupt)
    commands = (console.Command("", "go", "firmware_py.commands.release", "a command"),)
    of_the_tests = signal.signal(signal.SIGINT, signal.default_int_handler)  # may ignore it
    try:
        assert console.dispatch("tool", "", commands, ["go"]) == 130
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, of_the_tests)
    assert capsys.readouterr().err == "tool: interrupted\n"


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


def test_quiet_hides_progress_and_nothing_else(dispatched, capsys):
    job = a_job_with_progress(console.DONE, [])
    assert dispatched(job, "-q") == dispatched(job, "--quiet") == 0
    said = capsys.readouterr()
    assert said.err == "warning\n" * 2 and said.out == "result\n" * 2
    assert dispatched(job) == 0
    assert "job 2/2" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("missing", "said"),
    [
        ("models.trials", "belongs to the workshop, which is not installed here"),
        ("casadi", "needs casadi, which is not installed here"),
    ],
)
def test_a_package_that_is_missing_is_one_sentence(dispatched, capsys, monkeypatch, missing, said):
    def lacking(_):
        raise ModuleNotFoundError(f"No module named {missing!r}", name=missing)

    monkeypatch.setattr(console.importlib.util, "find_spec", lambda name: None)
    assert dispatched(lacking) == console.BAD_INPUT
    remedy = "use it in a checkout of the project after 'make setup'"
    assert capsys.readouterr().err == f"tool: echo: {said}; {remedy}.\n"


def test_a_missing_module_of_a_package_that_is_there_is_an_error_of_ours(dispatched):
    def lacking(_):
        raise ModuleNotFoundError("No module named 'models.nothing'", name="models.nothing")

    with pytest.raises(ModuleNotFoundError):
        dispatched(lacking)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("dropstitch sim", {"simulate"}),
        ("dropstitch fmu ", {"-h", "--help", "build", "check", "simulate", "ssp"}),
        ("dropstitch fmu build --pl", {"--plant", "--platforms"}),
        ("dropstitch import --as ", {"motive", "c3d", "rosbag", "recording", "table"}),
    ],
)
def test_a_shell_gets_what_may_follow(line, offered, tmp_path):
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


def test_completion_is_imported_only_for_a_shell():
    code = (
        "import sys; from dropstitch.__main__ import main; main(['--help']); "
        "sys.exit('argcomplete' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], stdout=subprocess.DEVNULL).returncode == 0


def test_a_full_disk_is_an_error_of_the_stream_that_carries_the_result_alone():
    with open("/dev/full", "w") as full:
        print("progress", file=LastingStream(full), flush=True)
    with open("/dev/full", "w") as full, pytest.raises(OSError, match="No space"):
        print("result", file=LastingStream(full, carries_result=True), flush=True)


def test_no_file_takes_the_number_of_a_stream_that_was_closed(tmp_path):
    script = (
        "import os\n"
        "from firmware_py.core.standard_streams import lasting_streams\n"
        f"with lasting_streams(), open({str(tmp_path / 'result')!r}, 'w'):\n"
        "    os.write(1, b'printed by a library in C')\n"
    )
    subprocess.run([sys.executable, "-c", script], preexec_fn=lambda: os.close(1), check=True)
    assert (tmp_path / "result").read_text() == ""
