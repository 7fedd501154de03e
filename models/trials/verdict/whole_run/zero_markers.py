"""Occlusions that an export wrote as zeros: all three coordinates of a marker exactly zero."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from models.trials.importers.series import Series
from models.trials.trial import Array
from models.trials.verdict.finding import ImportFinding


def without_zeros(
    series: list[Series], names: Iterable[str], zero_m: Array, remedy: str
) -> tuple[list[Series], list[ImportFinding]]:
    """Set markers at exactly zero (`zero_m`, shape (3,)) to NaN, with a finding that counts them.

    A marker that is never elsewhere is unchanged.
    """
    counts: dict[str, int] = {}
    times_s: list[Array] = []
    result = []
    for s in series:
        columns = dict(s.columns)
        for name in names:
            axes = [f"{name}_{axis}_m" for axis in "xyz"]
            if not all(axis in columns for axis in axes):
                continue
            zero = np.logical_and.reduce(
                [columns[axis] == at for axis, at in zip(axes, zero_m, strict=True)]
            )
            if zero.any() and np.isfinite(columns[axes[0]][~zero]).any():
                columns |= {axis: np.where(zero, np.nan, columns[axis]) for axis in axes}
                counts[name] = int(zero.sum())
                times_s.append(s.time_s[zero])
        result.append(replace(s, columns=columns) if counts else s)
    if not counts:
        return series, []
    listed = ", ".join(f"{name} in {n}" for name, n in counts.items())
    seen_s = np.concatenate(times_s)
    text = (
        f"markers are at exactly 0, 0, 0 between {seen_s.min():.2f} s and {seen_s.max():.2f} s "
        f"({listed} samples), as some exports write an occlusion"
    )
    return result, [ImportFinding("warning", "zeros", text, remedy)]
