"""Foreign files are read in a child process: one sentence at any end."""

import errno
import os
import signal
import tempfile
import time
from pathlib import Path

import pytest

from firmware_py.core.errors import InputError
from models.trials.guarded_call import guarded_call


def call(work, **limits):
    return guarded_call(work, "a.mat", "export it again", **limits)


def fail(error):
    raise error


def compute_for_ever():
    while True:
        pass


def test_the_result_arrives_whole():
    content = os.urandom(300_000)
    assert call(lambda: content) == content


REFUSAL = InputError("a.mat", "is no table", "export it")
FULL_DISK = OSError(errno.ENOSPC, "No space left on device", "trial.csv")


@pytest.mark.parametrize(
    ("work", "limits", "error", "sentence"),
    [
        (lambda: fail(REFUSAL), {}, InputError, r"^a\.mat: is no table; export it\.$"),
        (lambda: os.kill(os.getpid(), signal.SIGSEGV), {}, InputError, r"a\.mat: .* crashed; exp"),
        (lambda: 1 / 0, {}, InputError, r"\(ZeroDivisionError: .*; if the file is sound"),
        (lambda: fail(FULL_DISK), {}, OSError, "No space left"),
        (
            lambda: bytes(bytearray(2_000_000_000)), {"memory_bytes": 50_000_000}, InputError,
            "takes more than 50 MB to read",
        ),
        (lambda: time.sleep(60), {"seconds": 0.02}, InputError, r"more than 0\.02 s to read"),
        (compute_for_ever, {"seconds": 0.9}, InputError, r"takes more than 0\.9 s to read"),
    ],
    ids=["refusal", "crash", "internal error", "full disk", "memory", "time", "processor time"],
)  # fmt: skip
def test_any_other_end_is_one_sentence(work, limits, error, sentence):
    start_s = time.monotonic()
    with pytest.raises(error, match=sentence):
        call(work, **limits)
    assert time.monotonic() - start_s < 20


def test_temporary_files_go_with_the_child_and_files_are_limited(monkeypatch):
    monkeypatch.setattr("models.trials.guarded_call.MOST_WRITTEN_BYTES", 1000)

    def work():
        folder = tempfile.mkdtemp()
        Path(folder, "small").write_bytes(bytes(500))
        try:
            Path(folder, "large").write_bytes(bytes(5000))
        except OSError as error:
            return f"{folder}\n{error.errno}".encode()

    folder, number = call(work).decode().split("\n")
    assert os.strerror(int(number)) == "File too large" and not Path(folder).exists()


def test_without_a_fork_the_work_runs_here_with_the_same_sentences(monkeypatch, capfd):
    monkeypatch.delattr(os, "fork")  # as on Windows

    def work():
        print("a library talks")
        return str(os.getpid()).encode()

    assert call(work) == str(os.getpid()).encode()
    assert capfd.readouterr() == ("", "")
    for error, raised, sentence in (
        (REFUSAL, InputError, r"^a\.mat: is no table; ex"),
        (ValueError("codec"), InputError, r"a\.mat: cannot be read \(ValueError: codec\)"),
        (MemoryError(), InputError, r"a\.mat: takes more memory to read than there is"),
        (FULL_DISK, OSError, "No space left"),
    ):
        with pytest.raises(raised, match=sentence):
            call(lambda error=error: fail(error))
