"""Slice of the fuzzer, which `make fuzz-fmu` runs for ten minutes."""

import shutil

import pytest

from tests.fmu.fuzz.__main__ import build_fuzzer, fuzz


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("gcc"), reason="no gcc")
@pytest.mark.parametrize("fmi", [2, 3])
def test_no_sequence_of_calls_breaks_the_fmu(toy, tmp_path, fmi):
    result = fuzz(build_fuzzer(toy, fmi, tmp_path), seed=fmi, seconds=60, calls=200_000)
    assert not result.objection
    assert result.calls >= 200_000
    assert result.accepted > result.calls / 5  # else it would test refusals only
