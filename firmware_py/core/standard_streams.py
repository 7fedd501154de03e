"""Standard streams that may be missing or lose their reader without ending the work.

`command | head -1` closes the pipe after one line; under `pythonw` and `>&-` a stream is None.
"""

from __future__ import annotations

import contextlib
import errno
import io
import os
import sys
from collections.abc import Iterator
from typing import Any, TextIO, cast


class LastingStream:
    """Text stream that discards its input if it is missing or has lost its reader.

    It forwards the attributes of the stream, such as its encoding.

    `carries_result`: whether it carries the result of a command. Then other errors, such as a full
    disk, are raised; else they are ignored.
    """

    def __init__(self, stream: TextIO | None, *, carries_result: bool = False) -> None:
        self._stream, self._carries_result = stream, carries_result
        self._gone = stream is None

    def write(self, text: str) -> int:
        if self._stream is not None and not self._gone:
            with self._survived():
                self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        if self._stream is not None and not self._gone:
            with self._survived():
                self._stream.flush()

    def isatty(self) -> bool:
        return self._stream is not None and self._stream.isatty()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    @contextlib.contextmanager
    def _survived(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self._discard()
            if self._carries_result and not _is_without_reader(error):
                raise

    def _discard(self) -> None:
        """Redirect the rest of the buffer to nowhere; it would fail again when Python exits."""
        self._gone = True
        with contextlib.suppress(OSError, ValueError, AttributeError):
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self.fileno())
            os.close(nowhere)


def _is_without_reader(error: OSError) -> bool:
    """Whether a pipe has lost its reader, which Windows reports as an invalid argument."""
    is_windows = sys.platform == "win32"
    return isinstance(error, BrokenPipeError) or (is_windows and error.errno == errno.EINVAL)


@contextlib.contextmanager
def lasting_streams() -> Iterator[None]:
    """Let the block continue if stdout or stderr is missing or loses its reader.

    A broken stderr is ignored from then on, and so is stdout without a reader. Other errors of
    stdout, such as a full disk, are raised. A missing stdin is empty.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:  # or the next file gets this number, and C libraries print into it
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
    before = sys.stdin, sys.stdout, sys.stderr
    for stream in before[1:]:
        if isinstance(
            stream, io.TextIOWrapper
        ):  # a character that a terminal lacks must not end a run
            stream.reconfigure(errors="backslashreplace")
    out = cast(TextIO, LastingStream(sys.stdout, carries_result=True))
    err = cast(TextIO, LastingStream(sys.stderr))
    sys.stdin, sys.stdout, sys.stderr = before[0] or io.StringIO(), out, err
    try:
        yield
    finally:
        sys.stdin, sys.stdout, sys.stderr = before
