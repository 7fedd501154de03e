"""Work in a child process: whatever becomes of the child, the parent says one sentence."""

import errno
import os
import signal
import tempfile
import time
from pathlib import Path

import pytest

from firmware_py.core.errors import InputError
from firmware_py.core.guarded_call import guarded_call


def call(work, **limits):
    return guarded_call(work, "a.mat", "export it again", **limits)


def test_the_result_arrives_whole():
    content = os.urandom(300_000)
    assert call(lambda: content) == content


def test_a_refusal_arrives_as_it_was():
    def work():
        raise InputError("a.mat", "is no table", "export it")

    with pytest.raises(InputError, match=r"^a\.mat: is no table; export it\.$"):
        call(work)


def test_a_crash_is_one_sentence():
    with pytest.raises(InputError, match=r"a\.mat: .* or too large: .* crashed; export it again"):
        call(lambda: os.kill(os.getpid(), signal.SIGSEGV))


def test_an_error_of_ours_says_nothing_of_the_file():
    with pytest.raises(
        InputError, match=r"cannot be read \(ZeroDivisionError: .*; if the file is sound"
    ):
        call(lambda: 1 / 0)


def test_memory_is_limited():
    with pytest.raises(InputError, match="takes more than 50 MB to read"):
        call(lambda: bytes(bytearray(2_000_000_000)), memory_bytes=50_000_000)


def test_time_is_limited():
    start_s = time.monotonic()
    with pytest.raises(InputError, match=r"takes more than 0\.02 s to read"):
        call(lambda: time.sleep(60), seconds=0.02)
    assert time.monotonic() - start_s < 20


def test_processor_time_is_limited():
    def work():
        while True:
            pass

    with pytest.raises(InputError, match=r"takes more than 0\.9 s to read"):
        call(work, seconds=0.9)


def test_a_full_disk_is_said_and_is_no_damage_of_the_file():
    def work():
        raise OSError(errno.ENOSPC, "No space left on device", "trial.csv")

    with pytest.raises(OSError, match="No space left"):
        call(work)


def test_temporary_files_go_with_the_child_and_files_are_limited(monkeypatch):
    monkeypatch.setattr("firmware_py.core.guarded_call.MOST_WRITTEN_BYTES", 1000)

    def work():
        folder = tempfile.mkdtemp()
        Path(folder, "small").write_bytes(bytes(500))
        try:
            Path(folder, "large").write_bytes(bytes(5000))
        except OSError as error:
            return f"{folder}\n{error.errno}".encode()

    folder, number = call(work).decode().split("\n")
    assert os.strerror(int(number)) == "File too large" and not Path(folder).exists()


@pytest.fixture
def without_fork(monkeypatch):
    """A process as on Windows."""
    monkeypatch.delattr(os, "fork")


def test_without_a_fork_the_work_runs_here(without_fork, capfd):
    def work():
        print("a library talks")
        return str(os.getpid()).encode()

    assert call(work) == str(os.getpid()).encode()
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("error", "raised", "sentence"),
    [
        (InputError("a.mat", "is no table", "export it"), InputError, r"^a\.mat: is no table; ex"),
        (ValueError("codec"), InputError, r"a\.mat: cannot be read \(ValueError: codec\)"),
        (MemoryError(), InputError, r"a\.mat: takes more memory to read than there is; export it"),
        (OSError(errno.ENOENT, "gone"), InputError, "if the file is sound"),
        (OSError(errno.ENOSPC, "No space left"), OSError, "No space left"),
    ],
)
def test_without_a_fork_the_sentences_are_the_same(without_fork, error, raised, sentence):
    def work():
        raise error

    with pytest.raises(raised, match=sentence):
        call(work)
