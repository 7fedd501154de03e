"""Residuals of some rows of some trials, from simulations of all of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from models.gap.residuals.residuals import Residuals
from models.plant.identification.noise_floor import Array


@dataclass(frozen=True)
class SquaredError:
    """Sum of the squared errors of a signal, in its SI unit squared, over `rows` samples."""

    sum: float
    rows: int


class PartialResiduals(Residuals):
    """Residuals in which only some rows count; trials without any are left out.

    `counted`: by index of the trial, 1 for each row that counts, 0 otherwise, shape (n,).
    `derivatives`: returns the derivatives of `whole` from values and the wanted fit parameters, as
    `Residuals.jacobian` does: one run of all trials serves every part of them.
    """

    def __init__(
        self,
        whole: Residuals,
        counted: Mapping[int, Array],
        derivatives: Callable[[Array, NDArray[np.bool_]], list[Array]],
    ) -> None:
        vars(self).update(vars(whole))
        self._derivatives = derivatives
        self._parts = [
            [a for a, k in enumerate(g.trials) if k in counted and counted[k].any()]
            for g in whole.groups
        ]
        kept = [(g, part) for g, part in zip(whole.groups, self._parts, strict=True) if part]
        self.groups = [replace(g, trials=tuple(g.trials[a] for a in part)) for g, part in kept]
        self._follows = [
            rows * counted.get(k, np.zeros(len(rows))) for k, rows in enumerate(whole._follows)
        ]

    def jacobian(self, values: Array, wanted: NDArray[np.bool_]) -> list[Array]:
        """Derivatives as in `Residuals.jacobian`, selected from those of all trials."""
        every = self._derivatives(values, wanted)
        slopes = [s[part] for s, part in zip(every, self._parts, strict=True) if part]
        return [
            np.moveaxis(self.as_counted(g, np.moveaxis(s, -1, 0)), 0, -1)
            for g, s in zip(self.groups, slopes, strict=True)
        ]

    def squared_errors(self, values: Array) -> dict[str, SquaredError]:
        """Raw errors by signal, over the rows that count and were measured.

        Shapes: `values` (p,).
        """
        total: dict[str, SquaredError] = {}
        runs = self._runs(values)
        for group in self.groups:
            for k in group.trials:
                y, counts = runs[k], self._follows[k] > 0
                for signal in group.signals:
                    error = y[:, self._outputs.index(signal)] - self._measured[k][signal]
                    error = error[counts & np.isfinite(self._measured[k][signal])]
                    known = total.get(signal, SquaredError(0.0, 0))
                    total[signal] = SquaredError(
                        known.sum + float(error @ error), known.rows + len(error)
                    )
        return total
