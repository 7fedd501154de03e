"""Standard streams that are missing, or whose reader goes away."""

import os
import subprocess
import sys

import pytest

from firmware_py.core.standard_streams import LastingStream, lasting_streams


@pytest.fixture
def without_reader():
    """Stream into a pipe that nobody reads."""
    reader, writer = os.pipe()
    os.close(reader)
    with open(writer, "w") as stream:
        yield stream  # closing it would fail where it still held what nobody reads


@pytest.mark.parametrize("carries_result", [False, True])
def test_what_nobody_reads_is_discarded(without_reader, carries_result):
    stream = LastingStream(without_reader, carries_result=carries_result)
    for _ in range(2):
        print("x" * 100_000, file=stream, flush=True)
    assert stream.encoding == without_reader.encoding


def test_a_full_disk_is_an_error_of_the_stream_that_carries_the_result_alone():
    with open("/dev/full", "w") as full:
        print("progress", file=LastingStream(full), flush=True)
    with open("/dev/full", "w") as full, pytest.raises(OSError, match="No space"):
        print("result", file=LastingStream(full, carries_result=True), flush=True)


def test_streams_that_are_missing_can_be_used(monkeypatch):
    for name in ("stdin", "stdout", "stderr"):
        monkeypatch.setattr(sys, name, None)
    with lasting_streams():
        print("result", flush=True)
        print("message", file=sys.stderr)
        assert not any(s.isatty() for s in (sys.stdin, sys.stdout, sys.stderr))
        assert sys.stdin.read() == ""
    assert (sys.stdin, sys.stdout, sys.stderr) == (None, None, None)


def test_no_file_takes_the_number_of_a_stream_that_was_closed(tmp_path):
    script = (
        "import os\n"
        "from firmware_py.core.standard_streams import lasting_streams\n"
        f"with lasting_streams(), open({str(tmp_path / 'result')!r}, 'w'):\n"
        "    os.write(1, b'printed by a library in C')\n"
    )
    subprocess.run([sys.executable, "-c", script], preexec_fn=lambda: os.close(1), check=True)
    assert (tmp_path / "result").read_text() == ""
