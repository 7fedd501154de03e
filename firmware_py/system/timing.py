"""Timing statistics of the ticks: percentiles, histograms, misses and their causes."""

from __future__ import annotations

import array
import math
from collections.abc import Iterable
from enum import Enum
from typing import Any, Final, Self

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.core.signals import STAGES

Nanoseconds = NDArray[np.int64]

FRACTIONS: Final = {"p50_ns": 0.5, "p99_ns": 0.99, "p99_9_ns": 0.999}
"""Fraction of each percentile, by name of its field."""
LABELS: Final = {"p50": "p50_ns", "p99": "p99_ns", "p99.9": "p99_9_ns", "max": "max_ns"}
"""Field of each label."""
_SUB_BITS: Final = 6
_SUB_BUCKETS: Final = 1 << _SUB_BITS
_OCTAVES: Final = 40
"""Durations up to 2**40 ns, 18 minutes, are resolved."""

_BOUND_ERROR: Final = 0.05
_NEGLIGIBLE: Final = 1e-16


class Percentiles(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Percentiles of a series of durations, each an observed value."""

    n: int  # Number of durations; if it is 0, so are the other fields
    p50_ns: int  # Median
    p99_ns: int  # 99 % of the durations are at most this long
    p99_9_ns: int  # 99.9 % of the durations are at most this long
    max_ns: int  # Longest duration

    @classmethod
    def of(cls, durations_ns: Nanoseconds, **more: Any) -> Self:
        """Return the percentiles of a series of shape (n,)."""
        values = [0] * (len(FRACTIONS) + 1)
        if len(durations_ns):
            levels = (*FRACTIONS.values(), 1.0)
            values = np.quantile(durations_ns, levels, method="inverted_cdf").tolist()
        names = (*FRACTIONS, "max_ns")
        fields = {name: int(value) for name, value in zip(names, values, strict=True)}
        return cls(n=len(durations_ns), **fields, **more)


class Histogram:
    """Histogram of durations in constant memory, with a relative bucket width of at most 1/64.

    The layout is that of an HDR histogram: exact below 128 ns, then 64 buckets per octave.
    """

    def __init__(self) -> None:
        self.counts = array.array("q", bytes(8 * _SUB_BUCKETS * _OCTAVES))
        self.count = 0
        self.max_ns = 0

    def add(self, duration_ns: int) -> None:
        """Count one duration; a negative one counts as zero."""
        value = duration_ns if duration_ns > 0 else 0
        shift = value.bit_length() - _SUB_BITS - 1
        bucket = value if shift <= 0 else (shift << _SUB_BITS) + (value >> shift)
        self.counts[bucket if bucket < len(self.counts) else -1] += 1
        self.count += 1
        if value > self.max_ns:
            self.max_ns = value

    def percentile_ns(self, fraction: float) -> int:
        """Return a percentile, rounded up to the end of its bucket.

        `fraction`: fraction of the durations that do not exceed it, 0 to 1.
        """
        needed, counted = fraction * self.count, 0
        for bucket, count in enumerate(self.counts):
            counted += count
            if count and counted >= needed:
                return min(_upper_end_ns(bucket), self.max_ns)
        return 0

    def summary(self) -> Percentiles:
        """Return count, percentiles and maximum; zeros for an empty histogram."""
        fields = {name: self.percentile_ns(level) for name, level in FRACTIONS.items()}
        return Percentiles(n=self.count, max_ns=self.max_ns, **fields)


def _upper_end_ns(bucket: int) -> int:
    if bucket < 2 * _SUB_BUCKETS:
        return bucket
    shift = (bucket >> _SUB_BITS) - 1
    return ((bucket - (shift << _SUB_BITS) + 1) << shift) - 1


class Cause(Enum):
    """Cause of a missed deadline."""

    OWN_COMPUTE = "own compute"
    BUS_WAIT = "bus wait"
    PREEMPTED = "preempted by the host"


def cause_of_miss(excess_ns: int, host_ns: int, busy_ns: int, bus_wait_ns: int) -> Cause:
    """Return the cause of a tick that ended after its slot.

    It is the host if without it the tick would have ended in its slot, else the larger part of the
    tick: the wait for the bus or computing.

    `excess_ns`: time by which the tick ended after its slot. `host_ns`: time in the tick for which
    something outside this program had the processor.
    """
    if excess_ns <= host_ns:
        return Cause.PREEMPTED
    return Cause.BUS_WAIT if bus_wait_ns > busy_ns - bus_wait_ns else Cause.OWN_COMPUTE


class TimingSummary(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Timing statistics of a run."""

    stages: dict[str, Percentiles]  # Durations of each stage, and of "lateness", "busy" and "own"
    misses: int  # Number of missed slots
    longest_run_of_misses: int  # Largest number of consecutive missed slots
    causes: dict[str, int]  # Missed slots by cause
    miss_rate_upper_bound_95: float  # One-sided 95 % upper bound on the rate of missed slots


class Timing:
    """Timing of a run in constant memory: a histogram per stage, and missed slots by cause."""

    def __init__(self) -> None:
        self.stages = {name: Histogram() for name in (*STAGES, "lateness", "busy", "own")}
        self.misses, self.longest_run = 0, 0
        self.causes = dict.fromkeys(Cause, 0)
        self._stage_adders = [self.stages[name].add for name in STAGES]

    def add(
        self, stages_ns: Iterable[int], lateness_ns: int, busy_ns: int, bus_wait_ns: int
    ) -> None:
        """Count one tick."""
        for add, duration_ns in zip(self._stage_adders, stages_ns, strict=True):
            add(duration_ns)
        self.stages["lateness"].add(lateness_ns)
        self.stages["busy"].add(busy_ns)
        self.stages["own"].add(busy_ns - bus_wait_ns)

    def miss(self, slots: int, cause: Cause) -> None:
        """Count consecutive missed slots."""
        self.misses += slots
        self.longest_run = max(self.longest_run, slots)
        self.causes[cause] += slots

    def summary(self) -> TimingSummary:
        """Return the statistics so far."""
        ticks = self.stages["busy"].count
        return TimingSummary(
            stages={name: histogram.summary() for name, histogram in self.stages.items()},
            misses=self.misses,
            longest_run_of_misses=self.longest_run,
            causes={cause.value: count for cause, count in self.causes.items()},
            miss_rate_upper_bound_95=miss_rate_bound(self.misses, ticks + self.misses),
        )


def miss_rate_bound(misses: int, slots: int) -> float:
    """Return the one-sided 95 % upper bound on the miss rate by Clopper and Pearson.

    It is the rate at which this number of misses, or fewer, has a probability of 5 %. Without a
    miss it is 1 − 0.05^(1/n), just below 3/n (docs/sources.md, "Fixed-rate loop"). Without any slot
    it is 1.
    """
    if misses >= slots:
        return 1.0
    low, high = misses / slots, 1.0
    while low < (rate := 0.5 * (low + high)) < high:
        if _probability_of_at_most(misses, slots, rate) > _BOUND_ERROR:
            low = rate
        else:
            high = rate
    return high


def _probability_of_at_most(misses: int, slots: int, rate: float) -> float:
    """Return the binomial distribution function, summed downwards from its largest term.

    The rate must be at least misses / slots, so that the terms decrease.
    """
    term = total = math.exp(
        math.lgamma(slots + 1) - math.lgamma(misses + 1) - math.lgamma(slots - misses + 1)
        + misses * math.log(rate) + (slots - misses) * math.log1p(-rate)
    )  # fmt: skip
    odds = (1.0 - rate) / rate
    for k in range(misses, 0, -1):
        term *= k / (slots - k + 1) * odds
        total += term
        if term < _NEGLIGIBLE * total:
            break
    return total
