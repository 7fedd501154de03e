"""Synthetic runs of the loop."""

from __future__ import annotations

import numpy as np
import pytest

from firmware_py.core.signals import STAGES, tick_dtype

MS = 1_000_000
PERIOD_NS = 17 * MS


@pytest.fixture(scope="session")
def run_of():
    """Build ticks whose stages add up: 20 µs each, the read with 1 ms on top for the bus."""

    def build(ticks: int) -> np.ndarray:
        records = np.zeros(ticks, tick_dtype(1))
        records["tick"] = np.arange(ticks)
        records["deadline_ns"] = 10**12 + records["tick"] * PERIOD_NS
        for stage in STAGES:
            records[f"{stage}_ns"] = 20_000
        records["read_ns"] += MS
        records["bus_wait_ns"], records["lateness_ns"] = MS, 20_000
        records["busy_ns"] = sum(records[f"{s}_ns"] for s in STAGES) - records["lateness_ns"]
        return records

    return build
