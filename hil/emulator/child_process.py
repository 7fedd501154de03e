"""Process of this program behind a pipe, such as the emulator or a probe."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from typing import Any, Final, Generic, TypeVar

from firmware_py.core.errors import InputError

SPAWN: Final = multiprocessing.get_context("spawn")
Result = TypeVar("Result")


class ChildProcess(Generic[Result]):
    """Process that answers when it has started, and returns its result when it is stopped.

    `target` is called with the child's end of the pipe and the `arguments`. It sends its first
    answer, which `started` holds, and its result after it has received None.
    """

    def __init__(self, words: str, target: Callable[..., None], *arguments: Any) -> None:
        self._words = words
        self._pipe, child_end = SPAWN.Pipe()
        self._process = SPAWN.Process(target=target, args=(child_end, *arguments), daemon=True)
        self._process.start()
        child_end.close()
        self.started: Any = self._receive("did not start")
        self.pid = self._process.pid or 0

    def _receive(self, what: str) -> Any:
        try:
            return self._pipe.recv()
        except (EOFError, ConnectionError):
            self.close()
            remedy = "see its message above; is the disk full?"
            raise InputError(self._words, what, remedy) from None

    def tell(self, message: Any) -> None:
        self._pipe.send(message)

    def ask(self, message: Any) -> Any:
        self._pipe.send(message)
        return self._receive("ended early")

    def stop(self) -> Result:
        result: Result = self.ask(None)
        return result

    def close(self) -> None:
        """End the process if it is still running."""
        self._pipe.close()
        self._process.join()
