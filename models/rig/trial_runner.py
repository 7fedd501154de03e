"""Runner of many trials in several processes; a result depends on its case only."""

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
    """Simulate and write every case; return the CSV files in the order of the cases.

    `on_done` is called with the name of each trial after it is written.
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
