"""Run many trials on several processes and write them; a case's result depends on it alone."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any, Final

import msgspec

from firmware_py.errors import InputError
from models.rig.rig_parameters import RigParameters
from models.rig.study_protocol import run_case
from models.rig.trial_case import TrialCase
from models.trials.trial_files import write_trial

CONDITIONS_FILE: Final = "laboratory.json"
"""What was run, by trial: kept beside the trials and read by `refuse_other_conditions` only, so
that what is hidden stays out of the trials themselves."""

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def run_cases(
    cases: Sequence[TrialCase],
    parameters: RigParameters,
    directory: Path,
    workers: int,
    on_done: Callable[[str], None],
) -> list[Path]:
    """Run and write every case.

    Parameters
    ----------
    cases : sequence of TrialCase
        What to run.
    parameters : RigParameters
        Of the laboratory, with what is hidden in it.
    directory : Path
        Where the trials go.
    workers : int
        Number of processes; 1 runs in this one.
    on_done : callable
        Called with the name of each trial that is written.

    Returns
    -------
    list of Path
        CSV files in the order of the cases.
    """
    paths = {}
    if workers == 1 or len(cases) == 1:
        for case in cases:
            paths[case.name] = _run_and_write(parameters, case, directory)
            on_done(case.name)
    else:
        os.environ.update(dict.fromkeys(_THREADS, "1"))  # before the processes load numpy
        context = multiprocessing.get_context("spawn")
        ignore = (signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is this process's to handle
        with ProcessPoolExecutor(min(workers, len(cases)), context, signal.signal, ignore) as pool:
            futures = {
                pool.submit(_run_and_write, parameters, case, directory): case.name
                for case in cases
            }
            try:
                for future in as_completed(futures):
                    paths[futures[future]] = future.result()
                    on_done(futures[future])
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise
    return [paths[case.name] for case in cases]


def refuse_other_conditions(
    cases: Sequence[TrialCase], conditions: Mapping[str, Any], directory: Path
) -> None:
    """Refuse to overwrite a trial that was run under other conditions, or measured.

    Raises
    ------
    InputError
        If a name is taken.
    """
    record = _read_record(directory)
    for case in cases:
        if (directory / f"{case.name}.csv").exists() and record.get(case.name) != conditions:
            raise InputError(
                directory / f"{case.name}.csv",
                "holds a trial that was run under other conditions",
                "choose another --out, or remove it",
            )


def record_conditions(
    cases: Sequence[TrialCase], conditions: Mapping[str, Any], directory: Path
) -> None:
    """Add the conditions of these trials to the directory's record, before they are run."""
    directory.mkdir(parents=True, exist_ok=True)
    record = _read_record(directory) | {case.name: dict(conditions) for case in cases}
    text = msgspec.json.format(msgspec.json.encode(dict(sorted(record.items()))), indent=1)
    (directory / CONDITIONS_FILE).write_bytes(text + b"\n")


def _run_and_write(parameters: RigParameters, case: TrialCase, directory: Path) -> Path:
    return write_trial(run_case(parameters, case), directory)


def _read_record(directory: Path) -> dict[str, Any]:
    path = directory / CONDITIONS_FILE
    if not path.exists():
        return {}
    try:
        return msgspec.json.decode(path.read_bytes(), type=dict[str, Any])
    except msgspec.DecodeError as error:
        raise InputError(path, f"is damaged ({error})", "remove it and its trials") from None
