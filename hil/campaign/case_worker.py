"""Worker of a campaign: it runs one task and returns one outcome, even after an error.

Every engine calls `run_task` in its own processes. A worker refuses a task if its code or files
differ from those at the start of the campaign.
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
from typing import Final

import msgspec

from firmware_py.core.errors import InputError
from hil.campaign.case_task import CaseCost, CaseTask, TaskOutcome, canonical_json
from hil.campaign.code_version import code_version, content_sha256
from hil.campaign.kinds.case_kind import CaseContext, load_kind

if sys.platform != "win32":  # is imported there, see `firmware_py.core.console`
    import resource

MOST_LOG: Final = 20_000
"""Length to which a log is cut; its last characters are kept."""
_ONE_AT_A_TIME: Final = threading.Lock()
"""Lock for workers of dask with several threads: simulations in one process share libraries."""


def run_task(task: CaseTask) -> TaskOutcome:
    """Run one case; errors become outcomes."""
    with _ONE_AT_A_TIME:
        return _run(task)


def _run(task: CaseTask) -> TaskOutcome:
    printed = io.StringIO()
    start_s, start_cpu_s = time.perf_counter(), time.process_time()
    parts_s: dict[str, float] = {}

    def cost() -> CaseCost:
        return CaseCost(
            wall_s=time.perf_counter() - start_s,
            cpu_s=time.process_time() - start_cpu_s,
            memory_bytes=1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
            worker=f"{platform.node()}-{os.getpid()}",
            parts_s=parts_s,
        )

    with TemporaryDirectory(prefix="dropstitch-case-") as scratch:
        try:
            with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
                result = _result(task, CaseContext(Path(scratch), parts_s))
        except InputError as error:
            sentence = str(error).replace(scratch, "scratch")
            return TaskOutcome(
                key=task.key, state="refused", sentence=sentence,
                log=printed.getvalue()[-MOST_LOG:], cost=cost(),
            )  # fmt: skip
        except Exception as error:  # the campaign continues after any error
            sentence = f"{type(error).__name__}: {error}".replace(scratch, "scratch")
            log = f"{printed.getvalue()}\n{traceback.format_exc()}"
            return TaskOutcome(
                key=task.key, state="failed", sentence=" ".join(sentence.split())[:800],
                log=log[-MOST_LOG:], cost=cost(),
            )  # fmt: skip
    return TaskOutcome(key=task.key, state="done", result=result, cost=cost())


def _result(task: CaseTask, context: CaseContext) -> str:
    kind = load_kind(task.kind)
    if (own := code_version(kind.rooms)) != task.code:
        raise InputError(
            f"worker on {platform.node()}",
            f"has code {own}, the campaign has {task.code}",
            "bring both to the same sources and libraries, then run the command again",
        )
    for path, sha256 in task.files.items():
        if not Path(path).exists():
            raise InputError(path, "is missing on the worker", "put it where every worker finds it")
        if content_sha256(Path(path)) != sha256:
            raise InputError(
                path, "differs on the worker from what the campaign began with",
                "copy it again, start the workers anew",
            )  # fmt: skip
    config = msgspec.json.decode(task.config, type=kind.config)
    return canonical_json(kind.run(config, context))
