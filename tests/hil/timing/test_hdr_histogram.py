"""Histogram files: no percentile is understated."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.timing.hdr_histogram import write_hgrm


@given(st.lists(st.integers(0, 10**9), min_size=1, max_size=400))
def test_a_histogram_file_never_understates_a_percentile(tmp_path_factory, durations_ns):
    path = tmp_path_factory.mktemp("hgrm") / "tick.hgrm"
    write_hgrm(path, np.array(durations_ns))
    lines = path.read_text().splitlines()
    rows = [tuple(map(float, line.split()[:3])) for line in lines[2:] if not line.startswith("#")]
    values = np.array(durations_ns) / 1e3
    for value_us, fraction, count in rows:
        assert np.mean(values <= value_us + 1e-3) >= fraction - 1e-9
        assert count == np.sum(values <= value_us + 5e-4)
    assert [f for _, f, _ in rows] == sorted({f for _, f, _ in rows})
    assert rows[-1] == (pytest.approx(values.max(), abs=1e-3), 1.0, len(values))
    found = re.search(r"#\[Max +=(.*), Total count +=(.*)\]", path.read_text())
    assert (float(found[1]), int(found[2])) == (pytest.approx(values.max(), abs=1e-3), len(values))
