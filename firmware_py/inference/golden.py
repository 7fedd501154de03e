"""Golden ticks: results of estimator and predictor on the machine that made the bundle.

The robot replays them before it moves, so that a difference by other library versions or another
processor is detected before the start.
"""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import Source, check_archive, content_of
from firmware_py.inference.estimator import DeformationEstimator
from firmware_py.inference.predictor import Predictor

Array = NDArray[np.float64]
GOLDEN: Final = "golden.npz"
TOLERANCE: Final = 1e-9
"""Largest permitted difference, in the SI unit of each quantity."""
FEWEST_TICKS: Final = 100
"""Fewest golden ticks in which a joint moves: 1.7 s of a motion at 17 ms. [assumed]"""
_SHORTEST_S, _LONGEST_S = 1e-3, 1.0
"""Range of the period, as in robot.toml and in the manifest."""
_LEAST_WAY_RAD: Final = 1e-3
"""Least range of motion of some joint: one hundredth of the 5° of a first run. [assumed]"""


class Golden(NamedTuple):
    angle_rad: Array  # (n, dof)
    current_a: Array
    step_s: float
    di: Array  # (n,), DI by the estimator
    tip_m: Array  # (n, 3), tip by the predictor with that DI
    payload_kg: Array


def record_golden(
    estimator: DeformationEstimator,
    predictor: Predictor,
    angle_rad: Array,
    current_a: Array,
    step_s: float,
) -> Golden:
    """Run a motion through estimator and predictor; the estimator is reset before and after.

    Shapes: `angle_rad`, `current_a` (n, dof).
    """
    count = len(angle_rad)
    di, payload_kg, tip_m = np.empty(count), np.empty(count), np.empty((count, 3))
    estimator.reset()
    for k in range(count):
        di[k], payload_kg[k], signals = estimator.update(angle_rad[k], current_a[k], step_s)
        tip_m[k] = predictor.predict(angle_rad[k], current_a[k], di[k], signals).tip_m
    estimator.reset()
    return Golden(angle_rad, current_a, step_s, di, tip_m, payload_kg)


def write_golden(path: Path, golden: Golden) -> None:
    """Write the golden ticks; equal ticks give equal bytes."""
    np.savez(path, allow_pickle=False, **golden._asdict())


def read_golden(source: Source, dof: int) -> Golden:
    path, data = content_of(source)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            check_archive(archive, path, "copy the bundle again")
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            arrays = [np.asarray(file[name], dtype=np.float64) for name in Golden._fields]
    except InputError:
        raise
    except Exception as error:  # NumPy's header parser raises many kinds
        raise InputError(path, f"cannot be read ({error})", "copy the bundle again") from None
    count = len(np.atleast_1d(arrays[0]))
    shapes = [(count, dof), (count, dof), (), (count,), (count, 3), (count,)]
    if not count or [array.shape for array in arrays] != shapes:
        raise InputError(path, f"does not hold ticks of {dof} joints", "train the bundle again")
    angle_rad, current_a, step_s, di, tip_m, payload_kg = arrays
    golden = Golden(angle_rad, current_a, float(step_s), di, tip_m, payload_kg)
    _check_evidence(golden, path)
    return golden


def _check_evidence(golden: Golden, path: Path) -> None:
    """Refuse golden ticks that detect no difference: too few, not moving or not finite."""
    finite = all(np.isfinite(part).all() for part in golden[:-1])  # the payload may be NaN
    finite &= _SHORTEST_S <= golden.step_s <= _LONGEST_S
    way_rad = np.ptp(golden.angle_rad, axis=0).max()
    moving = np.count_nonzero(np.diff(golden.angle_rad, axis=0).any(axis=1))
    if moving < FEWEST_TICKS or not finite or not way_rad >= _LEAST_WAY_RAD:
        raise InputError(
            path, f"proves nothing: it does not hold {FEWEST_TICKS} finite ticks that move",
            "train the bundle again",
        )  # fmt: skip


def verify(
    golden: Golden, estimator: DeformationEstimator, predictor: Predictor, where: Path
) -> None:
    """Replay the golden ticks and refuse results that differ by more than `TOLERANCE`."""
    replayed = record_golden(
        estimator, predictor, golden.angle_rad, golden.current_a, golden.step_s
    )
    for name in ("di", "payload_kg", "tip_m"):
        expected, actual = getattr(golden, name), getattr(replayed, name)
        agree = np.isclose(actual, expected, rtol=0.0, atol=TOLERANCE, equal_nan=True)
        if not agree.all():
            tick = int(np.argwhere(~agree)[0][0])
            raise InputError(
                where,
                f"tick {tick}: {name} is {actual[tick]}, the bundle expects {expected[tick]}",
                "do not move the robot: build the bundle again on this software, or install the "
                "libraries that its manifest names",
            )


def verify_equal(
    golden: Golden,
    first: tuple[DeformationEstimator, Predictor],
    second: tuple[DeformationEstimator, Predictor],
    where: Path,
) -> None:
    """Refuse two runtimes whose predictions differ, interval and range included.

    They are compared on the golden ticks, with fresh samples and with samples of one period's age.
    """
    names = ("tip_m", "in_range", "half_width_m")
    for estimator, _ in (first, second):
        estimator.reset()
    for k, (angle_rad, current_a) in enumerate(
        zip(golden.angle_rad, golden.current_a, strict=True)
    ):
        estimates = [
            pair[0].update(angle_rad, current_a, golden.step_s) for pair in (first, second)
        ]
        for age_s in (0.0, golden.step_s) if k % 2 else (0.0,):
            one, other = (
                pair[1].predict(angle_rad, current_a, estimate.di, estimate.signals, age_s)
                for pair, estimate in zip((first, second), estimates, strict=True)
            )
            for name in names:
                expected, actual = getattr(one, name), getattr(other, name)
                if not np.allclose(actual, expected, rtol=0.0, atol=TOLERANCE, equal_nan=True):
                    raise InputError(
                        where, f"tick {k}: {name} is {actual} compiled and {expected} by "
                        "onnxruntime",
                        "do not move the robot: build the observer again, or choose "
                        'runtime = "onnx"',
                    )  # fmt: skip
    for estimator, _ in (first, second):
        estimator.reset()
