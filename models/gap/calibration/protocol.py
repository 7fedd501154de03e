"""Protocol of measured trials: their motions, payloads and conditions, to be run on drawn rigs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from models.gap.calibration.recorded_motion import recorded_motion
from models.plant.identification.noise_floor import trial_group_key
from models.rig.protocol import TrialCase
from models.trials.trial import Trial

MOST_PAYLOADS: Final = 5
"""Most payloads of a motion that are run; patterns are interpolated between them."""


def protocol_of(trials: Sequence[Trial]) -> tuple[TrialCase, ...]:
    """One case for each motion and payload of the trials, in their order."""
    first: dict[str, dict[float, Trial]] = {}
    for trial in trials:
        first.setdefault(trial_group_key(trial), {}).setdefault(trial.meta.payload_kg, trial)
    return tuple(
        _case(by_payload[payload_kg])
        for by_payload in first.values()
        for payload_kg in _evenly_chosen(sorted(by_payload))
    )


def repeated(cases: Sequence[TrialCase], repetitions: int, seed: int) -> list[TrialCase]:
    """Each case `repetitions` times, with the random numbers of a seed."""
    return [
        TrialCase(c.motion, c.payload_kg, trial, seed, c.pressure_pa, c.gravity)
        for c in cases
        for trial in range(1, repetitions + 1)
    ]


def _case(trial: Trial) -> TrialCase:
    meta = trial.meta
    return TrialCase(recorded_motion(trial), meta.payload_kg, 1, 0, meta.pressure_pa, meta.gravity)


def _evenly_chosen(payloads_kg: Sequence[float]) -> list[float]:
    """At most `MOST_PAYLOADS` of the payloads, evenly spread, both ends included."""
    most = min(MOST_PAYLOADS, len(payloads_kg))
    at = np.unique(np.round(np.linspace(0, len(payloads_kg) - 1, most)).astype(int))
    return [payloads_kg[k] for k in at]
