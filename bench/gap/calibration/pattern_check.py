"""Patterns of the plant's own error, tested on rigs that they were not learned on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from models.gap.estimation.model_discrepancy import patterns_of
from models.gap.residuals.spectrum import Array
from models.gap.settings import DEFAULT_SETTINGS

REPEATS: Final = 2
"""Trials that go into each mean curve of a drawn rig's plant."""


def left_out_residuals(rigs: Sequence[Mapping[str, Any]], patterns: int) -> Array:
    """Mean squared residual of each link, in floors, each rig left out of the patterns in turn.

    Parameters
    ----------
    rigs : sequence of mapping
        Files of `plant_error.pattern_case`: rows and noise relative to the own error.
    patterns : int
        Number of patterns; zero for none.
    """
    left = []
    for out, rig in enumerate(rigs):
        rest = [r for k, r in enumerate(rigs) if k != out]
        noise = np.mean(rig["noise"], axis=0)
        remains = DEFAULT_SETTINGS.model_error_left_fraction**2
        own = np.maximum(1 - noise / REPEATS, 0.0)
        scale = np.sqrt(noise + noise / REPEATS + remains * own)
        basis, kept = np.zeros((rig["rows"][0].size, 0)), np.zeros(0)
        if patterns:
            rows = np.concatenate([r["rows"] for r in rest])
            mean_noise = np.mean(np.concatenate([r["noise"] for r in rest]), axis=0)
            table = patterns_of(rows, mean_noise, patterns) / scale
            basis, size, _ = np.linalg.svd(table.reshape(len(table), -1).T, full_matrices=False)
            kept = 1 - 1 / np.sqrt(1 + size**2)
        for row in rig["rows"]:
            white = (row / scale).ravel()
            white = white - basis @ (kept * (basis.T @ white))
            left.append(float(np.mean(white**2)))
    return np.array(left)


def pattern_sentence(rigs: Sequence[Mapping[str, Any]]) -> str:
    """What the patterns leave on rigs left out, in words.

    Parameters
    ----------
    rigs : sequence of mapping
        As for `left_out_residuals`.
    """
    parts = []
    for count in (0, DEFAULT_SETTINGS.discrepancy_patterns):
        left = left_out_residuals(rigs, count)
        parts.append(f"{np.median(left):.2f} (90 %: {np.quantile(left, 0.9):.2f}) with {count}")
    links = sum(len(r["rows"]) for r in rigs)
    return (
        f"{links} links of {len(rigs)} rigs, each rig left out: median of the mean square in "
        f"floors {' and '.join(parts)} patterns"
    )
