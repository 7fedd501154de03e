"""C3D reader (through ezc3d): points as markers, and analog channels that the map names."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import open_bounded
from models.trials.recordings.mapping import RecordingMap, no_markers
from models.trials.recordings.series import Series, marker_columns

_METRES: Final = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}


def read_c3d(path: Path, mapping: RecordingMap) -> list[Series]:
    """Read markers, and second, if there are any, the analog channels that the map names."""
    import ezc3d  # only needed for C3D

    open_bounded(path, "name an existing C3D file").close()
    try:
        file = ezc3d.c3d(str(path))
    except MemoryError:
        raise
    except Exception as error:  # the library passes on any error of its parser
        what = f"is not C3D ({type(error).__name__}: {error})"
        raise InputError(path, what, "export it again") from None
    return [_points(path, file, mapping), *_analogs(path, file, mapping)]


def _value(file: Any, group: str, name: str) -> list[Any]:
    return list(file["parameters"].get(group, {}).get(name, {"value": []})["value"])


def _points(path: Path, file: Any, mapping: RecordingMap) -> Series:
    unit = str((_value(file, "POINT", "UNITS") or ["mm"])[0]).strip().lower()
    if unit not in _METRES:
        raise InputError(path, f"POINT:UNITS is {unit!r}", "export in m or mm")
    labels = [str(label).strip() for label in _value(file, "POINT", "LABELS")]
    points_m = _METRES[unit] * np.asarray(file["data"]["points"][:3])  # (3, markers, n)
    residuals = file["data"]["meta_points"]["residuals"][0]  # below zero: not reconstructed
    markers_m = {}
    for k, label in enumerate(labels[: points_m.shape[1]]):
        marker = mapping.marker_of(label)
        if marker in markers_m:
            raise InputError(path, f"holds two points for {marker}", "rename one of the two")
        if marker:
            markers_m[marker] = np.where(residuals[k] < 0, np.nan, points_m[:, k]).T
    if not markers_m:
        raise no_markers(path, labels)
    header = file["header"]["points"]
    rate_hz = _rate_hz(path, header["frame_rate"])
    time_s = (header["first_frame"] + np.arange(points_m.shape[2])) / rate_hz
    return Series(time_s, marker_columns(markers_m), path)


def _analogs(path: Path, file: Any, mapping: RecordingMap) -> list[Series]:
    labels = [str(label).strip() for label in _value(file, "ANALOG", "LABELS")]
    units = [str(unit).strip() for unit in _value(file, "ANALOG", "UNITS")]
    channels = np.asarray(file["data"]["analogs"])[0]  # (channels, n)
    columns = {}
    for name, column in mapping.columns.items():
        if column.source in labels:
            k = labels.index(column.source)
            if labels.count(column.source) > 1 or k >= len(channels):
                what = f"does not hold one channel {column.source!r}"
                raise InputError(path, what, "rename or export it again")
            unit = units[k] if k < len(units) else None
            columns[name] = column.to_si(path, name, channels[k].astype(np.float64), None, unit)
    if not columns:
        return []
    rate_hz = _rate_hz(path, file["header"]["analogs"]["frame_rate"])
    points = file["header"]["points"]
    start_s = points["first_frame"] / _rate_hz(path, points["frame_rate"])
    return [Series(start_s + np.arange(channels.shape[1]) / rate_hz, columns, path)]


def _rate_hz(path: Path, rate_hz: float) -> float:
    if not 1e-3 <= rate_hz <= 1e6:
        raise InputError(path, f"has a frame rate of {rate_hz} Hz", "export it again")
    return rate_hz
