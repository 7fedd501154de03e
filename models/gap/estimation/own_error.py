"""Model discrepancy: patterns of the plant's own error, which varies from one link to the next.

The plant is simpler than any link, and its error changes with the link's stiffness, mass and
damping: on links that it was not identified on it keeps an error that resembles friction near
standstill, or play. A few patterns hold most of that. They were measured on rigs without any hidden
effect, their nuisance drawn anew and refitted (`python -m models.gap.training`), and belong to the
noise floor: residual = noise + Σ a_m pattern_m, a_m ~ N(0, 1). So a residual that resembles one of
them counts no more than it did there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from zipfile import BadZipFile

import numpy as np

from firmware_py.core.errors import InputError
from models.gap.estimation.transfer import Knowledge, motion_of, transferred
from models.plant.identification.noise_floor import Array, TrialGroup
from models.plant.plant import Plant
from models.trials.trial import Trial

PATH: Final = Path(__file__).with_name("own_error.npz")


@dataclass(frozen=True)
class ModelDiscrepancy:
    """Patterns of the plant's error over links of one make."""

    key: str  # Motion of the trials, as `models.plant.identification.noise_floor.TrialGroup.key`
    payload_kg: Array  # (P,)
    signals: tuple[str, ...]
    # (M, P, signals, K), spectra of the patterns, scaled to their standard deviation, relative to
    # `models.gap.estimation.noise_floor.NoiseFloor.own_error` of the plant
    table: Array

    def rows(self, group: TrialGroup, trials: Sequence[Trial]) -> Array:
        """Relative patterns in the trials of a group, (M, trials, signals, K); zero where unknown.

        For trials of the same motion with another length, step or rest they are transferred
        (`models.gap.estimation.transfer`).
        """
        shape = len(group.trials), len(group.signals), group.coefficients
        result = np.zeros((len(self.table), *shape))
        found, _ = self.table_for(group, trials)
        if found is None:
            return result
        for a, k in enumerate(group.trials):
            at = float(np.clip(trials[k].meta.payload_kg, self.payload_kg[0], self.payload_kg[-1]))
            weights = [np.interp(at, self.payload_kg, row) for row in np.eye(len(self.payload_kg))]
            pattern = np.einsum("p,mpsk->msk", weights, found)
            for b, signal in enumerate(group.signals):
                if signal in self.signals:
                    result[:, a, b] = pattern[:, self.signals.index(signal)]
        return result

    def table_for(
        self, group: TrialGroup, trials: Sequence[Trial]
    ) -> tuple[Array | None, Knowledge]:
        """Table for the length, step and rest of a group, and how it is known."""
        first = trials[group.trials[0]]
        if group.key == self.key:
            return self.table, "measured"
        if motion_of(group.key) != motion_of(self.key):
            return None, "unknown"
        table = transferred(self.table, self.key, None, first, group.coefficients)
        return table, "unknown" if table is None else "transferred"


def write_patterns(patterns: Sequence[ModelDiscrepancy], path: Path = PATH) -> None:
    """Write patterns of several motions to a .npz file, in single precision."""
    arrays: dict[str, Any] = {}
    for k, own in enumerate(patterns):
        arrays |= {
            f"key_{k}": own.key, f"payload_kg_{k}": own.payload_kg,
            f"signals_{k}": np.array(own.signals), f"table_{k}": own.table.astype(np.float32),
        }  # fmt: skip
    fresh = path.with_suffix(".part.npz")
    np.savez_compressed(fresh, **arrays)
    fresh.replace(path)


def read_patterns(path: Path = PATH) -> tuple[ModelDiscrepancy, ...]:
    try:
        with np.load(path) as file:
            return tuple(
                ModelDiscrepancy(
                    str(file[f"key_{k}"]), file[f"payload_kg_{k}"],
                    tuple(file[f"signals_{k}"].tolist()), file[f"table_{k}"].astype(np.float64),
                )
                for k in range(sum(name.startswith("key_") for name in file))
            )  # fmt: skip
    except (OSError, ValueError, KeyError, BadZipFile) as error:
        raise InputError(
            str(path), f"holds no patterns of a plant's own error ({error})",
            "delete it, and run dropstitch calibrate again",
        ) from error  # fmt: skip


def patterns_for(
    plant: Plant, keys: Sequence[str], own: Sequence[ModelDiscrepancy] = ()
) -> tuple[ModelDiscrepancy, ...]:
    """Patterns of a plant for some motions: its own, else the packaged ones; none for
    other loads.
    """
    if plant.load != "link":
        return ()
    wanted = {motion_of(key) for key in keys}
    found: dict[str, ModelDiscrepancy] = {}
    for patterns in (*own, *(read_patterns() if PATH.exists() else ())):
        motion = motion_of(patterns.key)
        if motion in wanted:
            found.setdefault(motion, patterns)
    return tuple(found.values())


def patterns_of(residuals: Array, noise: Array, count: int) -> Array:
    """Largest patterns in the residuals of many links, in units of the noise.

    `residuals`: spectra of the nuisance fit's residual on each link, without noise. `count`: number
    of patterns M, at most the number of links.

    Shapes: `residuals` (links, P, signals, K), `noise` (signals, K). Returns principal components,
    each with its standard deviation, (M, P, signals, K).
    """
    links = len(residuals)
    scale = np.sqrt(noise)
    _, sizes, patterns = np.linalg.svd((residuals / scale).reshape(links, -1), full_matrices=False)
    scaled = (sizes / np.sqrt(links))[:count, None] * patterns[:count]
    return np.asarray(scaled.reshape(-1, *residuals.shape[1:]) * scale)
