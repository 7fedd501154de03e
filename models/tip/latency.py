"""Latency of a prediction, warm in a hot loop and cold as in the robot's loop."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

from firmware_py.inference.file_content import FileContent
from firmware_py.inference.predictor import OnnxGraph
from firmware_py.signals import PERIOD_S
from models.tip.predictors_document import Latency

__all__ = ["graph_latency", "measure_latency"]

WARM_CALLS: Final = 200
COLD_CALLS: Final = 25
"""Calls of which the median is taken; a cold one waits for a control period first."""
OUTPUTS: Final = (("tip_m", 3), ("in_range", 1), ("half_width_m", 3))


def measure_latency(call: Callable[[], object]) -> Latency:
    """Median duration of a call in a hot loop, and with a control period before each call."""
    return Latency(_median_s(call, WARM_CALLS, 0.0), _median_s(call, COLD_CALLS, PERIOD_S))


def _median_s(call: Callable[[], object], count: int, pause_s: float) -> float:
    taken_ns = []
    for _ in range(count):
        if pause_s:
            time.sleep(pause_s)
        start_ns = time.perf_counter_ns()
        call()
        taken_ns.append(time.perf_counter_ns() - start_ns)
    return float(np.median(taken_ns)) * 1e-9


def graph_latency(data: bytes) -> Latency:
    """Latency of a predictor's graph in onnxruntime."""
    return measure_latency(OnnxGraph(FileContent(Path("graph"), data), None, OUTPUTS).run)
