"""Patterns of the plant's own error, tested on rigs that they were not learned on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from models.gap.estimation.curve_transfer import motion_of
from models.gap.estimation.model_discrepancy import patterns_of
from models.gap.residuals.group_words import motion_in_words
from models.gap.settings import DEFAULT_SETTINGS
from models.plant.identification.noise_floor import Array
from models.shared.palette import MEASURED, MUTED, SIMULATED

REPEATS: Final = 2
"""Trials that go into each mean curve of a drawn rig's plant."""

MotionErrors = Sequence[Mapping[str, Array]]
"""Measured errors on each rig with one motion, see
`models.gap.calibration.pattern_measurement.own_errors_of`."""


def left_out_residuals(rigs: MotionErrors, patterns: int) -> Array:
    """Mean squared error on each link, in noise floors, with its rig left out of the patterns."""
    left = []
    for out, rig in enumerate(rigs):
        rest = [r for k, r in enumerate(rigs) if k != out]
        noise = rig["noise"]
        remains = DEFAULT_SETTINGS.model_error_left_fraction**2
        own = np.maximum(1 - noise / REPEATS, 0.0)
        scale = np.sqrt(noise + noise / REPEATS + remains * own)
        basis, kept = np.zeros((rig["rows"][0].size, 0)), np.zeros(0)
        if patterns and rest:
            rows = np.concatenate([r["rows"] for r in rest])
            mean_noise = np.mean([r["noise"] for r in rest], axis=0)
            table = patterns_of(rows, mean_noise, patterns) / scale
            basis, size, _ = np.linalg.svd(table.reshape(len(table), -1).T, full_matrices=False)
            kept = 1 - 1 / np.sqrt(1 + size**2)
        for row in rig["rows"]:
            white = (row / scale).ravel()
            white = white - basis @ (kept * (basis.T @ white))
            left.append(float(np.mean(white**2)))
    return np.array(left)


def pattern_sentence(rigs: MotionErrors) -> str:
    """Sentence on the error that the patterns leave on held-out rigs."""
    parts, links = [], sum(len(r["rows"]) for r in rigs)
    most = links - max(len(r["rows"]) for r in rigs)  # at most the number of links in training
    for count in (0, min(DEFAULT_SETTINGS.discrepancy_patterns, most)):
        left = left_out_residuals(rigs, count)
        parts.append(f"{np.median(left):.2f} (90 %: {np.quantile(left, 0.9):.2f}) with {count}")
    return (
        f"{links} links of {len(rigs)} rigs, each rig left out: median of the mean squared error, "
        f"in noise floors, {' and '.join(parts)} patterns"
    )


def draw_left_out(measured: Mapping[str, MotionErrors], path: Path) -> Path:
    """Draw the remaining error on each link, with and without patterns, by motion; returns the path
    (SVG).
    """
    from matplotlib import pyplot

    from models.shared.drawing import FILE_STYLE  # loads matplotlib

    with pyplot.rc_context(FILE_STYLE):
        figure, axes = pyplot.subplots(
            1, len(measured), squeeze=False, sharey=True, layout="constrained",
            figsize=(1.0 + 3.6 * len(measured), 3.4),
        )  # fmt: skip
        for ax, (key, rigs) in zip(axes[0], measured.items(), strict=True):
            without, with_patterns = (
                left_out_residuals(rigs, n) for n in (0, DEFAULT_SETTINGS.discrepancy_patterns)
            )
            order = np.argsort(without)
            links = np.arange(1, len(order) + 1)
            ax.axhline(1.0, color=MUTED, linewidth=0.8)
            ax.plot(links, without[order], "o", color=MEASURED, label="mean error subtracted")
            ax.plot(links, with_patterns[order], "o", color=SIMULATED, label="patterns as well")
            ax.set_yscale("log")
            ax.set_title(motion_in_words(motion_of(key)), fontsize=8, wrap=True)
            ax.set_xlabel("links, by their error", fontsize=8)
        axes[0, 0].set_ylabel("mean squared error in noise floors", fontsize=8)
        axes[0, 0].legend(fontsize=7)
        figure.suptitle("The plant's own error on links that changed, nothing hidden", fontsize=10)
        figure.savefig(path, format="svg")
        pyplot.close(figure)
    return path
