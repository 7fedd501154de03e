"""Rows of trials for tip predictors: inputs, measured tip, and the trial, motion and payload of
each.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_py.errors import InputError
from firmware_py.signals import AGE, feature_names, observer_signals, tip_names
from models.learning.predictors import Array
from models.trials.trial import Trial

__all__ = ["ObservedTrial", "TipRows", "collect_rows", "input_names"]


def input_names(dof: int) -> tuple[str, ...]:
    """Inputs of every candidate: measured signals, their age, and signals of the observer."""
    return (*feature_names(dof), AGE.name, *(signal.name for signal in observer_signals(dof)))


class ObservedTrial(NamedTuple):
    """Trial with the outputs of the observer that ran along it."""

    trial: Trial
    signals: Mapping[str, Array]  # (n,), outputs of the observer after each sample


@dataclass(frozen=True)
class TipRows:
    """Rows of several trials, stacked."""

    names: tuple[str, ...]  # Names of the input columns
    inputs: Array  # (n, inputs)
    tip_m: Array  # (n, 3), end effector by motion capture
    payload_kg: Array  # (n,)
    motion: NDArray[np.str_]  # (n,)
    run: NDArray[np.intp]  # (n,), index of the trial
    part: NDArray[np.str_]  # (n,), "rest" or "motion"

    def __len__(self) -> int:
        return len(self.run)

    def columns(self, names: Sequence[str]) -> list[int]:
        """Indices of input columns by name."""
        return [self.names.index(name) for name in names]

    def of(self, names: Sequence[str]) -> Array:
        """Input columns by name, shape (n, len(names))."""
        return self.inputs[:, self.columns(names)]

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_] | slice) -> TipRows:
        return TipRows(
            self.names, self.inputs[rows], self.tip_m[rows], self.payload_kg[rows],
            self.motion[rows], self.run[rows], self.part[rows],
        )  # fmt: skip

    @property
    def dof(self) -> int:
        return 2 if "angle_2_rad" in self.names else 1

    @property
    def observer_tip_m(self) -> Array:
        """Tip of the observer, shape (n, 3)."""
        return self.of(tip_names())


def collect_rows(observed: Sequence[ObservedTrial]) -> TipRows:
    """Stack the rows of trials, rest rows included; rows without a measured tip are left out."""
    names = input_names(observed[0].trial.meta.dof)
    parts: list[tuple[Array, ...]] = []
    motions, phases = [], []
    for number, (trial, signals) in enumerate(observed):
        columns = {**trial.columns, **signals, AGE.name: np.zeros(len(trial))}
        if missing := [name for name in names if name not in columns]:
            raise InputError(
                "observer", f"has no output {missing[0]}, which the predictors want",
                "choose a plant of the link",
            )  # fmt: skip
        inputs = np.column_stack([columns[name] for name in names])
        kept = np.isfinite(trial.tip_m).all(axis=1) & np.isfinite(inputs).all(axis=1)
        count = int(kept.sum())
        parts.append((
            inputs[kept], trial.tip_m[kept], np.full(count, trial.meta.payload_kg),
            np.full(count, number),
        ))  # fmt: skip
        motions.append(np.full(count, trial.meta.motion))
        moving = np.arange(len(trial)) >= trial.meta.rest_samples
        phases.append(np.where(moving, "motion", "rest")[kept])
    inputs, tip_m, payload_kg, run = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return TipRows(
        names, inputs, tip_m, payload_kg, np.concatenate(motions), run.astype(np.intp),
        np.concatenate(phases),
    )  # fmt: skip
