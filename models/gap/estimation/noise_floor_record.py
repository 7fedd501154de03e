"""Noise floor in the form that a plant file stores."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from models.gap.estimation.noise_floor import NoiseFloor
from models.gap.estimation.payload_ratios import PayloadRatios, RatioTable
from models.gap.residuals.spectrum import Array
from models.plant.document import FloorRecord


def floor_to_record(floor: NoiseFloor) -> FloorRecord:
    """Floor as stored in the plant file: a spectrum is one string of numbers."""
    return FloorRecord(
        frequency_hz=_text(floor.frequency_hz),
        repeats=floor.repeats,
        noise={s: _text(v) for s, v in floor.noise.items()},
        model={s: _text(v) for s, v in floor.model.items()},
        curves={
            key: {f"{p:g}": {s: _text(v) for s, v in own.items()} for p, own in table.items()}
            for key, table in floor.curves.items()
        },
        rest_s=dict(floor.rest_s),
        payload_ratio_hz=_text(floor.ratios.frequency_hz),
        noise_ratio=_ratio_text(floor.ratios.noise),
        model_ratio=_ratio_text(floor.ratios.model),
    )


def floor_from_record(record: FloorRecord) -> NoiseFloor:
    """Floor that a plant file stores; ValueError if its lengths differ."""
    floor = _as_written(record)
    ratios = [
        v for table in (floor.ratios.noise, floor.ratios.model) for own in table.values()
        for v in own.values()
    ]  # fmt: skip
    rows = [*floor.noise.values(), *floor.model.values()]
    lengths = [(rows, len(floor.frequency_hz)), (ratios, len(floor.ratios.frequency_hz))]
    for own, length in lengths:
        for row in own:
            if len(row) != length or not np.all(np.isfinite(row)) or np.any(row < 0):
                raise ValueError(f"{len(row)} numbers for {length} frequencies, or a negative one")
    if floor.repeats < 1 or floor.noise.keys() != floor.model.keys():
        raise ValueError("repeats, or the signals of noise and model")
    return floor


def _as_written(record: FloorRecord) -> NoiseFloor:
    return NoiseFloor(
        _row(record.frequency_hz),
        {s: _row(v) for s, v in record.noise.items()},
        {s: _row(v) for s, v in record.model.items()},
        {
            key: {float(p): {s: _row(v) for s, v in own.items()} for p, own in table.items()}
            for key, table in record.curves.items()
        },
        record.repeats,
        rest_s=record.rest_s,
        ratios=PayloadRatios(
            _row(record.payload_ratio_hz),
            _ratio_rows(record.noise_ratio),
            _ratio_rows(record.model_ratio),
        ),
    )


def _ratio_text(table: RatioTable) -> dict[str, dict[str, str]]:
    return {f"{p:g}": {s: _text(v) for s, v in own.items()} for p, own in table.items()}


def _ratio_rows(table: Mapping[str, Mapping[str, str]]) -> dict[float, dict[str, Array]]:
    return {float(p): {s: _row(v) for s, v in own.items()} for p, own in table.items()}


def _text(row: Array) -> str:
    return " ".join(f"{v:.4g}" for v in row)


def _row(text: str) -> Array:
    return np.array(text.split(), dtype=np.float64)
