"""Simulation of trials in lockstep: several of equal length and step at once, on two threads."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from models.plant.identification.noise_floor import Array
from models.plant.simulation.runner import trial_inputs
from models.plant.simulation.sensitivity import SensitiveModel
from models.plant.step_model import StepModel
from models.trials.trial import Trial

WORKERS: Final = 2
"""Threads that simulate; CasADi releases the interpreter lock meanwhile."""

LANES: Final = 4
"""Trials in lockstep: as many as a register of AVX2 holds."""

MOST_ROWS: Final = 40_000
"""Most rows of all trials of a batch, if it holds more than one: the derivatives of a row take 5 kB
for the link with every effect and two joints [assumed]."""


Result = TypeVar("Result")


@dataclass(frozen=True)
class Batch:
    """Trials that run in lockstep."""

    trials: tuple[int, ...]
    first: Array = field(repr=False)  # (m, inputs)
    u: Array = field(repr=False)  # (m, n - 1, inputs)
    step_s: float


class LockstepRuns:
    """Runs of trials by a compiled model, plain and with derivatives."""

    def __init__(self, model: StepModel, moved: Sequence[str], trials: Sequence[Trial]) -> None:
        self._trials = trials
        self._inputs = [trial_inputs(model, t) for t in trials]
        with ThreadPoolExecutor(2) as pool:  # the compiler runs twice at once
            self._plain, self._sensitive = pool.map(
                lambda wrt: SensitiveModel(model, wrt, lanes=LANES), ([], moved)
            )
        self._batches: dict[tuple[int, ...], list[Batch]] = {}

    def outputs(self, which: Iterable[int], p: Callable[[int], Array]) -> dict[int, Array]:
        """Outputs (n, outputs) of some trials; `p` gives the parameters by index."""

        def run(batch: Batch) -> list[Array]:
            own = np.stack([p(k) for k in batch.trials])
            return [*self._plain.simulate_several(batch.u, batch.step_s, own, batch.first)[0]]

        return self._each(run, which)

    def slopes(
        self,
        which: Iterable[int],
        p: Callable[[int], Array],
        wanted: NDArray[np.bool_],
        use: Callable[[int, Array], Result],
    ) -> dict[int, Result]:
        """Results of `use` on the derivatives of the outputs of some trials.

        `wanted`, shape (moved,): parameters to differentiate by; derivatives by the others are
        zero. `use` reduces the derivatives (n, outputs, moved) of the trial with an index.
        """

        def run(batch: Batch) -> list[Result]:
            own = np.stack([p(k) for k in batch.trials])
            _, slopes = self._sensitive.simulate_several(
                batch.u, batch.step_s, own, batch.first, wanted
            )
            return [use(k, slope) for k, slope in zip(batch.trials, slopes, strict=True)]

        return self._each(run, which)

    def _each(
        self, run: Callable[[Batch], list[Result]], which: Iterable[int]
    ) -> dict[int, Result]:
        key = tuple(which)
        if key not in self._batches:
            self._batches[key] = self._in_batches(key)
        batches = self._batches[key]
        with ThreadPoolExecutor(WORKERS) as pool:
            done = list(pool.map(run, batches))
        return {
            k: result
            for batch, results in zip(batches, done, strict=True)
            for k, result in zip(batch.trials, results, strict=True)
        }

    def _in_batches(self, which: Sequence[int]) -> list[Batch]:
        """Batches of trials of equal length and step, equally many per worker, the
        largest first.
        """
        alike: dict[tuple[int, float], list[int]] = {}
        for k in which:
            alike.setdefault((len(self._trials[k]), self._trials[k].step_s), []).append(k)
        result = []
        for (rows, step_s), own in alike.items():
            lanes = max(1, min(LANES, MOST_ROWS // rows))
            count = WORKERS * -(-len(own) // (WORKERS * lanes))
            for part in np.array_split(own, min(count, len(own))):
                trials = tuple(int(k) for k in part)
                first, u = (np.stack([self._inputs[k][i] for k in trials]) for i in (0, 1))
                result.append(Batch(trials, first, u, step_s))
        return sorted(result, key=lambda batch: -batch.u.size)
