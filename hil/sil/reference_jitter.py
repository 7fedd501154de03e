"""Reference jitter: lateness of wake-ups on the loop's processor, measured during the run.

A process of its own does nothing but wake by `clock_nanosleep` (`hil.sil.probe`), as cyclictest
of rt-tests does.
"""

from __future__ import annotations

from firmware_py.system.percentiles import Percentiles
from hil.sil.cpu_accounts import ProbeRecord


class ReferenceJitter(Percentiles, frozen=True, kw_only=True):
    """Lateness of a process that does nothing but wake, on the loop's processor."""

    period_ns: int  # Period of the wake-ups
    above_the_loop: bool  # Whether the priority was above the loop's

    @classmethod
    def of_probe(cls, probe: ProbeRecord) -> ReferenceJitter:
        """Return the jitter that a probe measured."""
        return cls.of(probe.lateness_ns, period_ns=probe.period_ns, above_the_loop=probe.proves)
