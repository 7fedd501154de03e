"""Comparison of the payload from robot.toml with an estimate from the recorded currents.

Nothing else detects a wrong `payload_kg`: the prediction is in range, but centimetres off. After
the run the observer processes its samples again and estimates the payload.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import FileContent, content_of
from firmware_py.inference.bundle import OBSERVER, ModelBundle
from firmware_py.inference.estimator import ObserverEstimator
from firmware_py.inference.fmu_instance import FmuInstance
from firmware_py.log.recording import read_recording
from firmware_py.safety.states import SafetyState
from firmware_py.summary import RunSummary

Array = NDArray[np.float64]

LONGEST_S: Final = 60.0
"""Longest part of a run that is evaluated: the estimate settles within seconds, and replaying a
minute takes 0.2 s."""
LONGEST_GAP_S: Final = 1.0
"""Longest gap between samples that the observer bridges [assumed: three swings of a link]."""
SHORTEST_STEP_S: Final = 1e-3
"""Shortest step of the observer; the samples of a late and a punctual tick are further apart."""
LEAST_DIFFERENCE: Final = 0.3
"""Smallest reported difference, relative to the observer's prior standard deviation (1 kg for the
study's link) [assumed: more than the error with a plant of another structure]."""
LEAST_DEVIATIONS: Final = 4.0
"""Smallest reported difference in standard deviations of the estimate [assumed: these hold for a
correct plant]."""
_VARIANCE: Final = "states.covariance_1_1"
_PRIOR_DEVIATION: Final = "parameters.payload_spread_kg"


class PayloadEstimate(NamedTuple):
    payload_kg: float
    # Standard deviation of the estimate; the prior one if nothing moved
    deviation_kg: float
    prior_deviation_kg: float  # Standard deviation before the first sample

    def contradicts(self, known_kg: float) -> bool:
        """Whether the estimate differs significantly from a payload."""
        least_kg = max(
            LEAST_DIFFERENCE * self.prior_deviation_kg, LEAST_DEVIATIONS * self.deviation_kg
        )
        return abs(self.payload_kg - known_kg) > least_kg


def unused_payload(bundle: ModelBundle, known_kg: float | None) -> str:
    """Return a sentence if the models of a bundle do not use a known payload, or "".

    `known_kg`: `payload_kg` of the run; the log and the goals of a plan use it anyway.
    """
    if known_kg is None or isinstance(bundle.estimator, ObserverEstimator):
        return ""
    return (
        f"payload_kg = {known_kg:g} changes no prediction and is not checked: the bundle "
        f"{bundle.directory} has no observer, which alone uses it; the log and a plan take the "
        "value as it is"
    )


def contradicted_payload(
    bundle: ModelBundle,
    known_kg: float | None,
    period_s: float,
    summary: RunSummary,
    log: Path | None = None,
) -> str:
    """Return a sentence if the currents of a run contradict its payload, or "".

    It never raises, since the run is over: an error of the comparison becomes a sentence. Without
    an observer in the bundle there is no comparison; the state of an observer is not changed.

    `known_kg`: `payload_kg` of the run; None if it was estimated anyway.
    `log`: log of the run, because the records in memory may lack its begin.
    """
    if known_kg is None or not isinstance(bundle.estimator, ObserverEstimator):
        return ""
    try:
        ticks = _first_ticks(summary, log, math.ceil(LONGEST_S / period_s))
        estimate = None if ticks is None else _estimate(bundle, ticks, period_s)
    except (Exception, KeyboardInterrupt) as error:
        reason = str(error) or type(error).__name__
        return f"payload_kg could not be compared with the currents of this run ({reason})"
    if estimate is None or not estimate.contradicts(known_kg):
        return ""
    return (
        f"the currents of this run fit a payload of {estimate.payload_kg:.2f} kg, payload_kg is "
        f"{known_kg:g} kg: the predicted tip may be off by centimetres and be called in range; "
        "weigh the load and correct payload_kg, or leave it out to have it estimated; "
        "if it is right, the link is no longer that of the bundle's plant"
    )


def _first_ticks(
    summary: RunSummary, log: Path | None, most: int
) -> Mapping[str, NDArray[Any]] | None:
    """Return the columns of the first ticks of a run; None if they were not recorded.

    The observer must start while the link rests: started in motion, its estimate was 1.6 kg off,
    with a small standard deviation.
    """
    records = summary.records
    if summary.ticks <= len(records):
        return {name: records[name][:most] for name in records.dtype.names or ()}
    return None if log is None else read_recording(log, most).columns


def _estimate(
    bundle: ModelBundle, ticks: Mapping[str, NDArray[Any]], period_s: float
) -> PayloadEstimate | None:
    """Estimate the payload from the samples of a run; None without usable samples."""
    samples = _samples(ticks, bundle.manifest.dof, period_s)
    with FmuInstance(_observer_of(bundle)) as fmu:
        observer, payload_kg = ObserverEstimator(fmu, bundle.manifest.dof), float("nan")
        for angle_rad, current_a, step_s in zip(*samples, strict=True):
            payload_kg = observer.update(angle_rad, current_a, float(step_s)).payload_kg
        variance, prior_kg = fmu.get([_VARIANCE, _PRIOR_DEVIATION])
    if not np.isfinite([payload_kg, variance, prior_kg]).all():
        return None
    return PayloadEstimate(payload_kg, float(max(variance, 0.0) ** 0.5), float(prior_kg))


def _observer_of(bundle: ModelBundle) -> FileContent:
    """Read the observer of the bundle; refuse one that was replaced during the run."""
    content = content_of(bundle.directory / OBSERVER)
    if content.sha256 != bundle.manifest.files[OBSERVER]:
        raise InputError(content.path, "was replaced during the run", "run again")
    return content


def _samples(
    ticks: Mapping[str, NDArray[Any]], dof: int, period_s: float
) -> tuple[Array, Array, Array]:
    """Return angles, currents and steps up to the first alert, stop or long gap, or a minute.

    After an alert a servo may have lost its torque, so its current does not show the load.
    """
    fresh = ticks["stale_ticks"] == 0
    over = ((ticks["state"] >= SafetyState.STOPPING) | (ticks["alert"] != 0))[fresh]
    time_s = (ticks["deadline_ns"] + ticks["sample_late_ns"])[fresh] * 1e-9
    step_s = np.diff(time_s, prepend=time_s[:1] - period_s)
    over |= (step_s > LONGEST_GAP_S) | (step_s <= 0.0) | (time_s > time_s[:1] + LONGEST_S)
    count = int(np.argmax(over)) if over.any() else len(over)
    angle_rad, current_a = (
        np.column_stack([ticks[name.format(j)][fresh][:count] for j in range(1, dof + 1)])
        for name in ("angle_{}_rad", "current_{}_a")
    )
    return angle_rad, current_a, np.maximum(step_s[:count], SHORTEST_STEP_S)
