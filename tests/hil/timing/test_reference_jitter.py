"""Reference jitter: percentiles of cyclictest's histogram, and none without cyclictest."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.realtime.percentiles import Percentiles
from hil.timing import reference_jitter


@given(st.dictionaries(st.integers(0, 500), st.integers(1, 1000), min_size=1))
def test_percentiles_of_the_reference_are_those_of_its_samples(counts):
    samples = np.repeat(list(counts), list(counts.values()))
    summary = reference_jitter.histogram_percentiles(counts, len(samples), max(counts))
    for name, fraction in (("p50_ns", 0.5), ("p99_ns", 0.99), ("p99_9_ns", 0.999)):
        assert getattr(summary, name) == 1000 * np.quantile(
            samples, fraction, method="inverted_cdf"
        )


def test_what_lies_beyond_the_references_histogram_counts_as_its_maximum():
    summary = reference_jitter.histogram_percentiles({10: 98}, 100, 70_000)
    assert summary == Percentiles(
        n=100, p50_ns=10_000, p99_ns=70_000_000, p99_9_ns=70_000_000, max_ns=70_000_000
    )


def test_without_cyclictest_there_is_no_reference(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with reference_jitter.cyclictest(0, 0.017, tmp_path) as running:
        assert running.stop() is None
