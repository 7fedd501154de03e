"""Noise floor in the form in which a plant file keeps it."""

from __future__ import annotations

import numpy as np

from models.gap.estimation.noise_floor import NoiseFloor
from models.gap.residuals.spectrum import Array
from models.plant.provenance import FloorRecord


def floor_to_record(floor: NoiseFloor) -> FloorRecord:
    """Floor as the plant file keeps it: a spectrum is one string of numbers."""
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
    )


def floor_from_record(record: FloorRecord) -> NoiseFloor:
    """Floor that a plant file keeps."""
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
    )


def _text(row: Array) -> str:
    return " ".join(f"{v:.4g}" for v in row)


def _row(text: str) -> Array:
    return np.array(text.split(), dtype=np.float64)
