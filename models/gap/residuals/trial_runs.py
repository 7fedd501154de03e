"""Simulation of many trials by a compiled model, on two threads."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from models.plant.identification.noise_floor import Array
from models.plant.simulation.runner import CompiledModel, trial_inputs
from models.plant.step_model import StepModel
from models.trials.trial import Trial

WORKERS: Final = 2
"""Threads that simulate; ctypes releases the interpreter lock meanwhile."""

Result = TypeVar("Result")


class TrialRuns:
    """Runs of trials, plain and with derivatives by the parameters `moved`."""

    def __init__(self, model: StepModel, moved: Sequence[str], trials: Sequence[Trial]) -> None:
        self._trials = trials
        self._inputs = [trial_inputs(model, t) for t in trials]
        with ThreadPoolExecutor(2) as pool:  # the compiler runs twice at once
            self._plain, self._sensitive = pool.map(
                lambda wrt: CompiledModel(model, wrt), ((), moved)
            )

    def outputs(self, which: Iterable[int], p: Callable[[int], Array]) -> dict[int, Array]:
        """Outputs (n, outputs) of some trials; `p` gives the parameters by index."""

        def run(k: int) -> Array:
            first, u = self._inputs[k]
            values = p(k)
            start = self._plain.start(first, values)
            return self._plain.simulate(u, self._trials[k].step_s, values, start)

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

        def run(k: int) -> Result:
            first, u = self._inputs[k]
            step_s = self._trials[k].step_s
            return use(k, self._sensitive.derivatives(u, step_s, p(k), first, wanted)[1])

        return self._each(run, which)

    def _each(self, run: Callable[[int], Result], which: Iterable[int]) -> dict[int, Result]:
        longest_first = sorted(which, key=lambda k: -len(self._trials[k]))
        with ThreadPoolExecutor(WORKERS) as pool:
            done = dict(zip(longest_first, pool.map(run, longest_first), strict=True))
        return {k: done[k] for k in sorted(done)}
