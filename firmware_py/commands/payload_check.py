"""Payload that the recorded currents show, compared with the one that the robot was told.

A wrong `payload_kg` shows nowhere else: the prediction is in range, and off by centimetres. After
the run the observer takes its samples once more with the payload left open.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_py.errors import InputError
from firmware_py.inference.bundle import OBSERVER, ModelBundle
from firmware_py.inference.estimator import ObserverEstimator
from firmware_py.inference.file_content import FileContent, content_of
from firmware_py.inference.fmu_instance import FmuInstance
from firmware_py.log.recording import read_recording
from firmware_py.safety.states import SafetyState
from firmware_py.summary import RunSummary

__all__ = ["PayloadEstimate", "contradicted_payload", "unused_payload"]

Array = NDArray[np.float64]

LONGEST_S: Final = 60.0
"""Time of a run that is looked at: the estimate settles within seconds, and a minute is replayed in
0.2 s."""
LONGEST_GAP_S: Final = 1.0
"""Longest time without a sample that the observer steps over [assumed: three swings of a link]."""
SHORTEST_STEP_S: Final = 1e-3
"""Shortest step of the observer: two samples of a late and of a punctual tick are further apart."""
LEAST_DIFFERENCE: Final = 0.3
"""Least difference that is told, over the observer's deviation before anything is measured (1 kg
for the study's link) [assumed: more than a plant of another structure errs by]."""
LEAST_DEVIATIONS: Final = 4.0
"""The same in standard deviations of the estimate [assumed: those are of a right plant]."""
_VARIANCE: Final = "states.covariance_1_1"
_PRIOR_DEVIATION: Final = "parameters.payload_spread_kg"


class PayloadEstimate(NamedTuple):
    """Payload by the currents of a run."""

    payload_kg: float
    # Its standard deviation by the observer; that of its start where nothing moved
    deviation_kg: float
    prior_deviation_kg: float  # Standard deviation before anything was measured

    def contradicts(self, told_kg: float) -> bool:
        """Whether it differs clearly from a payload."""
        least_kg = max(
            LEAST_DIFFERENCE * self.prior_deviation_kg, LEAST_DEVIATIONS * self.deviation_kg
        )
        return abs(self.payload_kg - told_kg) > least_kg


def unused_payload(bundle: ModelBundle, told_kg: float | None) -> str:
    """Return a sentence where a bundle has no use of the payload that it is told, or "".

    `told_kg`: `payload_kg` of the run. It is kept for the log and for the goals of a plan.
    """
    if told_kg is None or isinstance(bundle.estimator, ObserverEstimator):
        return ""
    return (
        f"payload_kg = {told_kg:g} changes no prediction and is not checked: the bundle "
        f"{bundle.directory} has no observer, which alone uses it; the log and a plan take the "
        "value as it is"
    )


def contradicted_payload(
    bundle: ModelBundle,
    told_kg: float | None,
    period_s: float,
    summary: RunSummary,
    log: Path | None = None,
) -> str:
    """Return a sentence where the currents of a run fit another payload than the told one, or "".

    It never raises: a fault of the comparison is a sentence, for the run is over.

    `bundle`: of the run; its own observer is left as it is. One without an observer tells nothing.
    `told_kg`: `payload_kg` of the run; None where it was estimated anyway.
    `log`: its log: the records in memory may lack the begin of the run.
    """
    if told_kg is None or not isinstance(bundle.estimator, ObserverEstimator):
        return ""
    try:
        ticks = _first_ticks(summary, log, math.ceil(LONGEST_S / period_s))
        found = None if ticks is None else _estimate(bundle, ticks, period_s)
    except (Exception, KeyboardInterrupt) as error:
        reason = str(error) or type(error).__name__
        return f"payload_kg could not be compared with the currents of this run ({reason})"
    if found is None or not found.contradicts(told_kg):
        return ""
    return (
        f"the currents of this run fit a payload of {found.payload_kg:.2f} kg, the robot was told "
        f"{told_kg:g} kg (payload_kg): the predicted tip may be off by centimetres and be called "
        "in range; weigh the load and correct payload_kg, or leave it out to have it estimated; "
        "if it is right, the link is no longer that of the bundle's plant"
    )


def _first_ticks(
    summary: RunSummary, log: Path | None, most: int
) -> Mapping[str, NDArray[Any]] | None:
    """Columns of the first ticks of a run; None where they are kept nowhere.

    The observer has to begin where the link rests: begun in motion it was off by 1.6 kg, and sure.
    """
    records = summary.records
    if summary.ticks <= len(records):
        return {name: records[name][:most] for name in records.dtype.names or ()}
    return None if log is None else read_recording(log, most).columns


def _estimate(
    bundle: ModelBundle, ticks: Mapping[str, NDArray[Any]], period_s: float
) -> PayloadEstimate | None:
    """Payload by the samples of a run; None where no sample counts."""
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
    """Observer of the bundle, unless it was replaced while the robot ran."""
    content = content_of(bundle.directory / OBSERVER)
    if content.sha256 != bundle.manifest.files[OBSERVER]:
        raise InputError(content.path, "was replaced during the run", "run again")
    return content


def _samples(
    ticks: Mapping[str, NDArray[Any]], dof: int, period_s: float
) -> tuple[Array, Array, Array]:
    """Angles, currents and steps up to the first alert, stop or long gap, a minute at most.

    A servo that has lost its torque says nothing of the load.
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
