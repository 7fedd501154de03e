"""Check that trials are of one link, and of the plant's."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from firmware_py.errors import InputError
from models.plant.identification.doubts import check_weight
from models.plant.plant import Plant
from models.trials.trial import Trial, TrialSet
from models.trials.verdict.trial_check import refuse_mixed_links

__all__ = ["SAME_SIZE_FRACTION", "refuse_other_links"]

SAME_SIZE_FRACTION: Final = 0.01
"""Largest difference in size, relative to the length: the accuracy of a tape [assumed]."""


def refuse_other_links(plant: Plant, where: Path | str, trials: Sequence[Trial]) -> None:
    """Refuse trials of several links, and trials of another link than the plant's.

    A plant that is no link has nothing to compare.
    """
    if plant.load != "link":
        return
    refuse_mixed_links(trials)
    for trial in trials:
        length_m = trial.meta.link_length_m
        for name in ("link_length_m", "link_width_m", "base_offset_m") if length_m else ():
            own_m, there_m = plant.parameters[name].value, getattr(trial.meta, name)
            if abs(there_m - own_m) > SAME_SIZE_FRACTION * length_m:
                raise InputError(
                    trial.path, f"{name} is {there_m:g} m, in the plant {where} {own_m:g} m",
                    "correct the one that is wrong, or name a plant of this link",
                )  # fmt: skip
    check_weight(plant, TrialSet(tuple(trials)))
