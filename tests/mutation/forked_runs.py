"""Runs of pytest in processes forked from one that has imported libraries, but not the project.

Whatever imports a mutated module imports the mutant, in the forked process as in the Python
programs that a test starts with its environment. A mutant in the C of the FMU is compiled into
every FMU that the forked process builds.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import hypothesis
import pytest

from tests.mutation.hook import sitecustomize
from tests.mutation.mutants import Mutant

HOOK = Path(sitecustomize.__file__).parent
LIBRARIES = (
    "numpy", "scipy.optimize", "scipy.signal", "scipy.stats", "scipy.io", "scipy.interpolate",
    "scipy.integrate", "scipy.spatial.transform", "casadi", "mujoco", "onnx", "onnxruntime",
    "skl2onnx", "sklearn.pipeline", "sklearn.linear_model", "sklearn.preprocessing",
    "sklearn.ensemble", "sklearn.neural_network", "sklearn.model_selection", "fmpy",
    "fmpy.validation", "msgspec", "control", "pandas", "matplotlib.figure", "jinja2", "tomli_w",
    "rosbags.highlevel", "ezc3d", "elastica", "dynamixel_sdk", "serial", "lxml.etree",
    "xml.etree.ElementTree", "hypothesis.extra.numpy", "_hypothesis_pytestplugin",
)  # fmt: skip

hypothesis.settings.register_profile(
    "mutation", max_examples=8, database=None, deadline=None, derandomize=True,
    phases=[hypothesis.Phase.explicit, hypothesis.Phase.generate],
)  # fmt: skip


class Run(NamedTuple):
    """One run of pytest, with `mutant` in place or none."""

    arguments: tuple[str, ...]
    root: Path
    limit_s: float
    mutant: Mutant | None = None
    subject: str = ""


class Ended(NamedTuple):
    run: Run
    result: str
    """Of the mutant: "survived" (all tests pass), "killed", "timeout" or "invalid" (not C)."""
    taken_s: float
    output: str


def import_libraries() -> None:
    for name in LIBRARIES:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)


def _module(run: Run) -> str:
    parts = run.mutant.path.relative_to(run.root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _in_child(run: Run, scratch: Path) -> int:
    os.setsid()
    with open(scratch / "output", "wb") as output, open(os.devnull, "rb") as nothing:
        os.dup2(nothing.fileno(), 0)
        os.dup2(output.fileno(), 1)
        os.dup2(output.fileno(), 2)
    # A mutant may ask for any amount of memory or disk.
    for kind, most in ((resource.RLIMIT_DATA, 4 << 30), (resource.RLIMIT_FSIZE, 1 << 30)):
        resource.setrlimit(kind, (most, resource.getrlimit(kind)[1]))
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # `nohup` and `&` have these two ignored
    signal.signal(signal.SIGINT, signal.default_int_handler)
    os.chdir(run.root)
    # Recordings of other machines are not everywhere, so that no fraction depends on them.
    os.environ.update(TMPDIR=str(scratch), DROPSTITCH_DATA=str(scratch / "none"))
    tempfile.tempdir = None
    if run.mutant is not None and run.mutant.path.suffix == ".c":
        _use_c(run.mutant, scratch)
    elif run.mutant is not None:
        (scratch / "mutant.py").write_bytes(run.mutant.source())
        os.environ[sitecustomize.MODULE] = _module(run)
        os.environ[sitecustomize.SOURCE] = str(scratch / "mutant.py")
        os.environ["PYTHONPATH"] = os.pathsep.join(
            [str(HOOK), *filter(None, [os.environ.get("PYTHONPATH")])]
        )
        sitecustomize.install()
    hypothesis.settings.load_profile("mutation")
    return int(pytest.main([
        "-x", "-q", "--tb=short", "--no-header", "-p", "no:xdist", "-p",
        "no:cacheprovider", f"--basetemp={scratch / 'pytest'}", *run.arguments,
    ]))  # fmt: skip


def _use_c(mutant: Mutant, scratch: Path) -> None:
    """Let every FMU be built from sources with the mutant."""
    fmu_builder = importlib.import_module("fmu.fmu_builder")
    shutil.copytree(fmu_builder.WRAPPER, scratch / "c")
    (scratch / "c" / mutant.path.name).write_bytes(mutant.source())
    fmu_builder.WRAPPER = scratch / "c"
    importlib.import_module("models.shared.c_compiler").CACHE = scratch / "cache"


def _start(run: Run) -> tuple[int, Path]:
    scratch = Path(tempfile.mkdtemp(prefix="mutant"))
    sys.stdout.flush()
    sys.stderr.flush()
    child = os.fork()
    if child == 0:
        code = 1
        try:
            code = _in_child(run, scratch)
        finally:
            os._exit(code)
    return child, scratch


def ended_runs(runs: Iterable[Run], workers: int, report: Callable[[Ended], None]) -> list[Ended]:
    """Run all, `workers` at a time; the results come in the order of `runs`."""
    waiting, running, ended = list(enumerate(runs))[::-1], {}, {}
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                k, run = waiting.pop()
                child, scratch = _start(run)
                running[child] = (k, run, scratch, time.monotonic())
            for child, end in [*_over(running)]:
                k, *_ = running.pop(child)
                ended[k] = end
                report(end)
            time.sleep(0.02)
    finally:
        for child, (_, _, scratch, _) in running.items():
            _end_group(child)
            shutil.rmtree(scratch, ignore_errors=True)
    return [ended[k] for k in sorted(ended)]


def _over(running) -> Iterator[tuple[int, Ended]]:
    for child, (_, run, scratch, start_s) in running.items():
        over, status = os.waitpid(child, os.WNOHANG)
        taken_s = time.monotonic() - start_s
        if not over and taken_s < run.limit_s:
            continue
        _end_group(child)
        if not over:
            os.waitpid(child, 0)
        output = (scratch / "output").read_text(errors="replace")
        result = "timeout" if not over else "survived" if status == 0 else "killed"
        if run.mutant is not None and "the C compiler refused" in output:
            result = "invalid"
        shutil.rmtree(scratch, ignore_errors=True)
        yield child, Ended(run, result, taken_s, output)


def _end_group(child: int) -> None:
    """End a run and what it has started."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(child, signal.SIGKILL)
