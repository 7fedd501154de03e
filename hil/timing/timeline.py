"""Timeline of a run for ui.perfetto.dev, in the Chrome trace format (JSON).

One track shows slots and stages, one the wait for the bus, one the stalls of the processor that the
probe measured. For a long run it contains the beginning, and the ticks around the longest ones and
around missed deadlines.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.bus.servo_bus import BusStatus
from firmware_py.safety.states import SafetyState
from firmware_py.signals import STAGES
from hil.timing.cpu_accounts import STALL_NS, ProbeRecord

MOST_TICKS: Final = 3000
_NEIGHBOURS: Final = 5
_TRACKS: Final = {1: "loop", 2: "bus", 3: "host (probe)"}
_PROCESS: Final = 1


def write_timeline(
    path: Path, records: NDArray[np.void], loop_cpu: ProbeRecord, period_ns: int
) -> None:
    shown = select_ticks(records, period_ns)
    origin_ns = int(records["deadline_ns"][0]) if len(records) else 0
    events = [_track(number, name) for number, name in _TRACKS.items()]
    for record in records[shown]:
        events += _tick(record, origin_ns, period_ns)
    events += _stalls(loop_cpu, origin_ns)
    note = {"ticks": len(records), "shown": int(shown.sum())}
    document = {"traceEvents": events, "displayTimeUnit": "ms", "otherData": note}
    path.write_text(json.dumps(document, separators=(",", ":")), encoding="utf-8")


def select_ticks(records: NDArray[np.void], period_ns: int) -> NDArray[np.bool_]:
    """Return a mask of the ticks to show, shape (n,): all of a short run, a part of a long one.

    The part is the beginning, and the ticks around the longest ones and around misses.
    """
    if len(records) <= MOST_TICKS:
        return np.ones(len(records), bool)
    taken = records["lateness_ns"] + records["busy_ns"]
    chosen = np.zeros(len(records), bool)
    chosen[: MOST_TICKS // 3] = True
    remarkable = np.argsort(taken, kind="stable")[::-1][: MOST_TICKS // (4 * _NEIGHBOURS)]
    remarkable = np.union1d(remarkable, np.flatnonzero(taken > period_ns)[: MOST_TICKS // 20])
    for offset in range(-_NEIGHBOURS, _NEIGHBOURS + 1):
        chosen[np.clip(remarkable + offset, 0, len(records) - 1)] = True
    return chosen


def _track(number: int, name: str) -> dict[str, Any]:
    identity = {"ph": "M", "pid": _PROCESS, "tid": number}
    return {"name": "thread_name", **identity, "args": {"name": name}}


def _slice(track: int, name: str, start_ns: int, length_ns: int, **facts: Any) -> dict[str, Any]:
    event: dict[str, Any] = {
        "ph": "X", "pid": _PROCESS, "tid": track, "name": name,
        "ts": start_ns / 1e3, "dur": max(length_ns, 0) / 1e3,
    }  # fmt: skip
    return event | ({"args": facts} if facts else {})


def _tick(record: np.void, origin_ns: int, period_ns: int) -> Iterator[dict[str, Any]]:
    start_ns = int(record["deadline_ns"]) - origin_ns
    taken_ns = int(record["lateness_ns"] + record["busy_ns"])
    status = BusStatus(int(record["bus_status"])).name
    yield _slice(
        1, f"tick {int(record['tick'])}", start_ns, taken_ns, bus=status,
        state=SafetyState(int(record["state"])).name,
        run_queue_delay_us=int(record["preempted_ns"]) / 1e3,
    )  # fmt: skip
    at_ns = start_ns
    for stage in STAGES:
        length_ns = int(record[f"{stage}_ns"])
        yield _slice(1, stage, at_ns, length_ns)
        if stage == "read":
            wait_ns = int(record["bus_wait_ns"])
            yield _slice(2, f"wait: {status}", at_ns + length_ns - wait_ns, wait_ns)
        at_ns += length_ns
    if taken_ns > period_ns:
        yield {
            "ph": "i", "s": "g", "pid": _PROCESS, "tid": 1, "name": "missed",
            "ts": (start_ns + period_ns) / 1e3,
        }  # fmt: skip


def _stalls(watch: ProbeRecord, origin_ns: int) -> Iterator[dict[str, Any]]:
    for wake_ns, late_ns in zip(watch.wake_ns.tolist(), watch.lateness_ns.tolist(), strict=True):
        if late_ns >= STALL_NS:
            yield _slice(3, "stood still", wake_ns - late_ns - origin_ns, late_ns)
