"""Worker of a campaign: it runs one task and returns one outcome, even after an error.

Both executors call `run_case` in processes of their own. A worker refuses a task if its code or
files differ from those at the start of the campaign.
"""

from __future__ import annotations

import contextlib
import io
import os
import platform
import sys
import threading
import time
import traceback
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, Literal

import msgspec

from firmware_py.core.errors import InputError
from hil.campaign.code_version import code_version, content_sha256
from hil.campaign.kinds.case_kind import load_kind

if sys.platform != "win32":  # is imported there, see `firmware_py.core.console`
    import resource

MOST_LOG: Final = 20_000
"""Length to which a log is cut; its last characters remain."""
_ONE_AT_A_TIME: Final = threading.Lock()
"""Lock for workers of dask with several threads: simulations in one process share libraries."""

State = Literal["done", "refused", "failed", "killed"]
"""How a case ended: it has a result, its input cannot be used, its code failed, or its workers
died."""


class CaseTask(msgspec.Struct, frozen=True, kw_only=True):
    """One case as sent to a worker."""

    key: str  # Hash of all options and the version of the code
    kind: str  # Module of the kind
    options: bytes  # As JSON, with absolute paths
    files: dict[str, str]  # SHA-256 of every file or directory that the case reads, by path
    code: str  # Version of the code at the start of the campaign


class CaseCost(msgspec.Struct, frozen=True, kw_only=True):
    """Measured cost of a case, which is not part of its result."""

    key: str
    code: str
    state: str
    wall_s: float  # Without the start of the worker
    cpu_s: float  # Processor time without the start of the worker
    memory_bytes: int  # Peak memory of the worker so far
    worker: str  # Host and process of the worker


class CaseOutcome(msgspec.Struct, frozen=True, kw_only=True):
    """Outcome of a case."""

    state: State
    result: dict[str, Any] = {}  # Empty if there is none
    sentence: str = ""  # Why there is no result
    log: str = ""  # Output and traceback of a case without a result
    cost: CaseCost | None = None  # None if the worker died


def run_case(task: CaseTask) -> CaseOutcome:
    """Run one case; errors become outcomes."""
    printed = io.StringIO()
    with (
        _ONE_AT_A_TIME,
        TemporaryDirectory(prefix="dropstitch-case-") as scratch,
        contextlib.redirect_stdout(printed),
        contextlib.redirect_stderr(printed),
    ):
        start_s, start_cpu_s = time.perf_counter(), time.process_time()
        state: State = "done"
        result, sentence = dict[str, Any](), ""
        try:
            result = _result(task, Path(scratch))
        except InputError as error:
            state, sentence = "refused", str(error)
        except Exception as error:  # the campaign continues after any error
            state, sentence = "failed", f"{type(error).__name__}: {error}"
            print("\n" + traceback.format_exc())
        cost = CaseCost(
            key=task.key, code=task.code, state=state,
            wall_s=time.perf_counter() - start_s, cpu_s=time.process_time() - start_cpu_s,
            memory_bytes=1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
            worker=f"{platform.node()}-{os.getpid()}",
        )  # fmt: skip
    return CaseOutcome(
        state=state, result=result, cost=cost,
        sentence=" ".join(sentence.replace(scratch, "scratch").split())[:800],
        log=printed.getvalue()[-MOST_LOG:] if state != "done" else "",
    )  # fmt: skip


def _result(task: CaseTask, scratch: Path) -> dict[str, Any]:
    kind, _ = load_kind(task.kind)
    if (code := code_version(kind.sources)) != task.code:
        raise InputError(
            f"worker on {platform.node()}",
            f"has code {code}, the campaign has {task.code}",
            "bring both to the same sources and libraries, then run the command again",
        )
    for path, sha256 in task.files.items():
        if not Path(path).exists():
            raise InputError(path, "is missing on the worker", "put it where every worker finds it")
        if content_sha256(Path(path)) != sha256:
            raise InputError(
                path, "differs on the worker from what the campaign began with",
                "copy it there again, or run the command again",
            )  # fmt: skip
    result = kind.run(msgspec.json.decode(task.options, type=kind.options), scratch)
    plain: dict[str, Any] = msgspec.json.decode(msgspec.json.encode(result))  # NaN becomes null
    return plain
