"""Runner of many trials on several processes; the result of a case depends on the case alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from pathlib import Path

from models.rig.rig_parameters import RigParameters
from models.rig.study_protocol import run_case
from models.rig.trial_case import TrialCase
from models.shared.worker_pool import worker_pool
from models.trials.trial_files import write_trial


def run_trial_cases(
    cases: Sequence[TrialCase],
    parameters: RigParameters,
    directory: Path,
    workers: int,
    on_done: Callable[[str], None],
) -> list[Path]:
    """Run and write every case.

    `on_done`: called with the name of each trial that is written.
    Returns CSV files in the order of the cases.
    """
    paths = {}
    if workers == 1 or len(cases) == 1:
        for case in cases:
            paths[case.name] = _run_and_write(parameters, case, directory)
            on_done(case.name)
    else:
        with worker_pool(min(workers, len(cases))) as pool:
            futures = {
                pool.submit(_run_and_write, parameters, case, directory): case.name
                for case in cases
            }
            for future in as_completed(futures):
                paths[futures[future]] = future.result()
                on_done(futures[future])
    return [paths[case.name] for case in cases]


def _run_and_write(parameters: RigParameters, case: TrialCase, directory: Path) -> Path:
    return write_trial(run_case(parameters, case), directory)
